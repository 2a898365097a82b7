"""Rays through boxes, prisms, half discs, rods and lenses obey the laws of textbooks."""

import jax
import numpy as np
import pytest

from raytrace_jax import build, optics
from raytrace_jax.report.lessons import bodies
from raytrace_jax.report.lessons.bodies import INDEX, path

APEX = np.radians(60)


def trace(body, start, direction):
    """The rays of one in the plane z = 0."""
    return bodies.trace(body, *(np.append(vector, 0.0) for vector in (start, direction)))


def behind(nodes):
    """The ray behind a body; None where none leaves it."""
    return dict(enumerate(path(nodes))).get(2)


def turned(a, b):
    """The angle from one ray to the next in the plane, clockwise."""
    return np.arctan2(a.d[1], a.d[0]) - np.arctan2(b.d[1], b.d[0])


def test_a_block_moves_a_ray_aside_and_leaves_its_direction():
    block = build.box("block", material="glass", center=(0.1, 0, 0), right=(0.4, 0, 0), up=(0, 30, 0), depth=1)
    for degrees in (0, 10, 45, 70, 85):
        i = np.radians(degrees)
        nodes = trace(block, (-1, 0), (np.cos(i), np.sin(i)))
        last = behind(nodes)
        r = np.arcsin(np.sin(i) / INDEX)
        normal = np.array([-np.sin(i), np.cos(i), 0])
        np.testing.assert_allclose(last.d, nodes[0].d, rtol=0, atol=1e-12)
        assert normal @ (nodes[0].o - last.o) == pytest.approx(0.8 * np.sin(i - r) / np.cos(r), abs=1e-12)


def prism_turn(theta):
    prism = build.prism("prism", material="glass", point=(0, 0, 0), axis=(0, 0, 0.5), down=(0, -1, 0), apex=60)
    d = np.array([np.cos(theta - APEX / 2), np.sin(theta - APEX / 2)])
    nodes = trace(prism, 0.5 * np.array([-np.sin(APEX / 2), -np.cos(APEX / 2)]) - d, d)
    return nodes, behind(nodes)


def test_a_prism_turns_rays_least_where_the_formula_says():
    for theta in np.radians([30, 40, 48, 60, 80]):
        nodes, last = prism_turn(theta)
        inner = APEX - np.arcsin(np.sin(theta) / INDEX)
        wanted = theta + np.arcsin(INDEX * np.sin(inner)) - APEX
        assert turned(nodes[0], last) == pytest.approx(wanted, abs=1e-12)
        assert float(optics.prism_deviation(theta, INDEX, APEX)) == pytest.approx(wanted, abs=1e-12)
    symmetric = np.arcsin(INDEX * np.sin(APEX / 2))
    at = [turned(nodes[0], last) for nodes, last in map(prism_turn, symmetric + np.array([-1e-3, 0, 1e-3]))]
    assert at[1] < min(at[0], at[2])
    assert np.sin((APEX + at[1]) / 2) / np.sin(APEX / 2) == pytest.approx(INDEX, abs=1e-12)
    assert float(optics.prism_index(at[1], APEX)) == pytest.approx(INDEX, abs=1e-12)
    assert float(optics.prism_least_deviation(INDEX, APEX)) == pytest.approx(at[1], abs=1e-12)
    assert prism_turn(np.radians(27))[1] is None  # Totally reflected: less than 27.9 degrees.


def test_half_a_disc_bends_rays_at_its_flat_side_alone():
    disc = build.cylinder("disc", material="glass", center=(0, 0, 0), axis=(0, 0, 0.2), radius=1, cut=(0, 1, 0))
    critical = np.arcsin(1 / INDEX)
    for theta in (0.2, 0.6, critical - 1e-6, critical + 1e-6, 1.2):
        d = np.array([np.sin(theta), np.cos(theta)])
        nodes = trace(disc, -2 * d, d)
        inner = next(node for node in nodes if node.kind == "transmitted")
        np.testing.assert_allclose(inner.d, nodes[0].d, rtol=0, atol=1e-12)
        np.testing.assert_allclose(inner.p, 0, atol=1e-12)
        assert inner.total == (theta > critical)
        if inner.total:
            assert inner.reflect == 1
            back = next(node for node in nodes if node.parent == inner.number)
            np.testing.assert_allclose(back.d, [d[0], -d[1], 0], rtol=0, atol=1e-12)
        else:
            assert np.arcsin(behind(nodes).d[0]) == pytest.approx(np.arcsin(INDEX * d[0]), abs=1e-8)


def crossing(body, height):
    """Where a ray parallel to x crosses that axis, and the focal length for it, that of small angles."""
    last = behind(trace(body, (-4, height), (1, 0)))
    return last.o[0] - last.o[1] * last.d[0] / last.d[1], -height / (last.d[1] / last.d[0])


@pytest.mark.parametrize(
    ("curvatures", "thickness"), [((0.3, -0.3), 0.7), ((0.5, 0.0), 0.4), ((0.0, -0.5), 0.4), ((0.02, -0.01), 0.05)]
)
def test_lenses_have_the_lensmakers_focal_length(curvatures, thickness):
    first, last = curvatures
    lens = build.lens("lens", material="glass", center=(0, 0, 0), axis=(2, 0, 0), curvature1=first, curvature2=last,
                      thickness=thickness, diameter=2)  # fmt: skip
    k = (INDEX - 1) / INDEX * thickness
    f = 1 / ((INDEX - 1) * (first - last + k * first * last))
    # The error of a ray near the axis falls with the square of its height: Richardson's limit.
    coarse, fine = (np.array(crossing(lens, height)) for height in (2e-2, 1e-2))
    place, length = fine + (fine - coarse) / 3
    assert length == pytest.approx(f, rel=1e-7)
    assert place - thickness / 2 == pytest.approx(f * (1 - k * first), rel=1e-7)
    formula = optics.lensmaker_focal_length(first, last, INDEX, thickness)
    assert formula == pytest.approx((f, f * (1 - k * first)), rel=1e-12)
    if thickness < 0.1:  # That of a thin one is nearly the same.
        assert optics.lensmaker_focal_length(first, last, INDEX).effective == pytest.approx(f, rel=1e-3)


def test_a_ball_focuses_as_a_rod_does_across_its_axis_and_along_it_a_rod_does_not():
    ball = build.sphere("body", material="glass", center=(0, 0, 0), radius=0.8)
    rod = build.cylinder("body", material="glass", center=(0, 0, 0), axis=(0, 0, 1), radius=0.8)
    f = INDEX * 0.8 / (2 * (INDEX - 1))
    for body in (ball, rod):
        coarse, fine = (np.array(crossing(body, height)) for height in (2e-2, 1e-2))
        np.testing.assert_allclose(fine + (fine - coarse) / 3, f, rtol=1e-7)
    assert f == pytest.approx(float(optics.lens_focal_length(0.8, INDEX).effective), rel=1e-12)
    lying = build.cylinder("body", material="glass", center=(0, 0, 0), axis=(0, 1, 0), radius=0.8)
    last = behind(trace(lying, (-4, 0.3), (1, 0)))
    np.testing.assert_allclose([*last.d, last.o[1]], [1, 0, 0, 0.3], rtol=0, atol=1e-12)


CASES = {
    "least": (optics.prism_least_deviation, (1.5, 1.0)),
    "index": (optics.prism_index, (0.65, 1.0)),
    "lens": (lambda *lens: sum(optics.lensmaker_focal_length(*lens)), (0.4, -0.3, 1.5, 0.2)),
}


@pytest.mark.parametrize("name", CASES)
def test_formulas_have_the_derivatives_of_differences(name):
    function, values = CASES[name]
    reverse, forward = (np.array(mode(function, tuple(range(len(values))))(*values)) for mode in (jax.grad, jax.jacfwd))
    steps = 1e-5 * np.eye(len(values))
    difference = [float(function(*(values + step)) - function(*(values - step))) / 2e-5 for step in steps]
    np.testing.assert_allclose(forward, difference, rtol=1e-7)
    np.testing.assert_allclose(reverse, difference, rtol=1e-7)
