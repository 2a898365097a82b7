"""Angles, reflectances and the ball: values and derivatives against closed forms, laws, and the hard places."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax import RaytraceError, optics

ANGLES = st.floats(0.0, 1.55)
ETAS = st.floats(0.35, 3.0)


def parallel(c, eta):
    return optics.fresnel_amplitudes(c, eta)[0]


def effective(radius, eta):
    return optics.lens_focal_length(radius, eta).effective


def back(radius, eta):
    return optics.lens_focal_length(radius, eta).back


def cosines(c, eta):
    return c, np.sqrt(1 - (1 - c * c) / eta**2)


def snell_slopes(theta_i, eta):
    theta_t = np.arcsin(np.sin(theta_i) / eta)
    return np.cos(theta_i) / (eta * np.cos(theta_t)), -np.tan(theta_t) / eta


def parallel_slopes(c, eta):
    c, t = cosines(c, eta)
    return 2 * (eta**2 - 1) / (eta * t * (eta * c + t) ** 2), 2 * c * (2 * t**2 - 1) / (t * (eta * c + t) ** 2)


def perpendicular_slopes(c, eta):
    c, t = cosines(c, eta)
    return 2 * (eta**2 - 1) / (eta * t * (c + eta * t) ** 2), -2 * c / (t * (c + eta * t) ** 2)


def fresnel_slopes(c, eta):
    c, t = cosines(c, eta)
    parallel, perpendicular = (eta * c - t) / (eta * c + t), (c - eta * t) / (c + eta * t)
    both = zip(parallel_slopes(c, eta), perpendicular_slopes(c, eta), strict=True)
    return tuple(parallel * one + perpendicular * other for one, other in both)


def schlick_slopes(c, ior):
    r0 = ((ior - 1) / (ior + 1)) ** 2
    return -5 * (1 - r0) * (1 - c) ** 4, (1 - (1 - c) ** 5) * 4 * (ior - 1) / (ior + 1) ** 3


def deviation_slopes(k):
    def slopes(theta_i, eta):
        theta_t = np.arcsin(np.sin(theta_i) / eta)
        along = 2 - 2 * (k + 1) * np.cos(theta_i) / (eta * np.cos(theta_t))
        return along, 2 * (k + 1) * np.tan(theta_t) / eta

    return slopes


def rainbow_slope(eta):
    q = (eta**2 - 1) / 3
    return (-eta / (3 * np.sqrt(q * (1 - q))),)


def rainbow_angle_slope(eta):
    return (-4 * np.tan(np.arcsin(np.sqrt((4 - eta**2) / 3) / eta)) / eta,)


def slab_slopes(theta_i, eta, thickness):
    theta_t = np.arcsin(np.sin(theta_i) / eta)
    cos_i, cos_t = np.cos(theta_i), np.cos(theta_t)
    along = cos_i + np.sin(theta_i) * np.tan(theta_t) - cos_i**2 / (eta * cos_t**3)
    by_eta = cos_i * np.sin(theta_t) / (eta * cos_t**3)
    return thickness * along, thickness * by_eta, np.sin(theta_i - theta_t) / cos_t


def prism_slopes(theta_i, eta, apex):
    theta_t = np.arcsin(np.sin(theta_i) / eta)
    inner, cos_t = apex - theta_t, np.cos(theta_t)
    cos_o = np.sqrt(1 - (eta * np.sin(inner)) ** 2)
    by_apex = eta * np.cos(inner) / cos_o - 1
    return 1 - np.cos(theta_i) * np.cos(inner) / (cos_t * cos_o), np.sin(apex) / (cos_t * cos_o), by_apex


def least_slopes(eta, apex):
    cos = np.sqrt(1 - (eta * np.sin(apex / 2)) ** 2)
    return 2 * np.sin(apex / 2) / cos, eta * np.cos(apex / 2) / cos - 1


def index_slopes(deviation, apex):
    half = np.sin(apex / 2)
    return np.cos((deviation + apex) / 2) / (2 * half), -np.sin(deviation / 2) / (2 * half**2)


def lensmaker_slopes(c1, c2, eta, thickness):
    k, f = eta - 1, 1 / ((eta - 1) * (c1 - c2 + (eta - 1) * thickness * c1 * c2 / eta))
    by_eta = c1 - c2 + thickness * c1 * c2 * (1 - 1 / eta**2)
    slopes = k * (1 + k * thickness * c2 / eta), k * (k * thickness * c1 / eta - 1), by_eta, k * k * c1 * c2 / eta
    return tuple(-f * f * slope for slope in slopes)


def focal(*lens):
    return optics.lensmaker_focal_length(*lens).effective


ANGLE_CASES = [(0.0, 1.5), (0.6, 1.5), (1.5, 1.5), (0.3, 0.7), (0.77, 0.7), (1.2, 1.0), (0.5, 1 / 1.0003)]
COSINE_CASES = [(1.0, 1.5), (0.5, 1.5), (1e-3, 1.5), (0.0, 1.5), (0.9, 0.7), (0.72, 0.7), (0.4, 1.0), (1.0, 0.7)]
LENS_CASES = [(2.0, 1.5), (0.5, 2.5), (3.0, 0.7), (1.0, 1.01)]

FORMULAS = {
    "snell_angle": (optics.snell_angle, snell_slopes, ANGLE_CASES),
    "critical_angle": (optics.critical_angle, lambda eta: (1 / np.sqrt(1 - eta**2),), [(0.2,), (1 / 1.5,), (0.999,)]),
    "parallel": (parallel, parallel_slopes, COSINE_CASES),
    "perpendicular": (lambda c, eta: optics.fresnel_amplitudes(c, eta)[1], perpendicular_slopes, COSINE_CASES),
    "fresnel_dielectric": (optics.fresnel_dielectric, fresnel_slopes, COSINE_CASES),
    "fresnel_schlick": (optics.fresnel_schlick, schlick_slopes, COSINE_CASES),
    "through": (optics.sphere_deviation, deviation_slopes(0), ANGLE_CASES),
    "rainbow": (lambda *both: optics.sphere_deviation(*both, 1), deviation_slopes(1), ANGLE_CASES),
    "rainbow_incidence": (optics.rainbow_incidence, rainbow_slope, [(1.05,), (1.333,), (1.9,)]),
    "rainbow_angle": (optics.rainbow_angle, rainbow_angle_slope, [(1.2,), (1.333,), (1.9,)]),
    "brewster_angle": (optics.brewster_angle, lambda eta: (1 / (1 + eta**2),), [(0.7,), (1.0,), (1.5,)]),
    "slab_shift": (optics.slab_shift, slab_slopes, [(0.0, 1.5, 2.0), (0.8, 1.5, 0.3), (0.3, 0.7, 1.0)]),
    "prism_deviation": (optics.prism_deviation, prism_slopes, [(0.8, 1.5, 1.0), (-0.1, 1.5, 0.5), (0.3, 0.8, 0.2)]),
    "least": (optics.prism_least_deviation, least_slopes, [(1.5, 1.0), (0.8, 0.5), (1.9, 0.2)]),
    "prism_index": (optics.prism_index, index_slopes, [(0.6, 1.0), (-0.1, 0.5), (1.2, 0.3)]),
    "lensmaker": (focal, lensmaker_slopes, [(1.0, -0.5, 1.5, 0.2), (0.0, -2.0, 1.7, 0.5), (0.8, 0.1, 0.7, 0.0)]),
    "effective": (effective, lambda r, eta: (eta / (2 * (eta - 1)), -r / (2 * (eta - 1) ** 2)), LENS_CASES),
    "back": (back, lambda r, eta: (eta / (2 * (eta - 1)) - 1, -r / (2 * (eta - 1) ** 2)), LENS_CASES),
}
"""A function, its derivatives in closed form by each of its arguments, and where to compare them."""


@pytest.mark.parametrize("name", FORMULAS)
def test_derivatives_are_the_closed_forms(name):
    function, slopes, cases = FORMULAS[name]
    arguments = tuple(jnp.asarray(column) for column in zip(*cases, strict=True))
    expected = np.stack([slopes(*case) for case in cases], axis=1)

    @jax.jit  # one program of each formula, not one of each of its operations
    def both_modes(*arguments):
        value, pull = jax.vjp(function, *arguments)
        places = range(len(arguments))
        tangents = [tuple(jnp.full_like(x, float(k == at)) for k, x in enumerate(arguments)) for at in places]
        return [jax.jvp(function, arguments, tangent)[1] for tangent in tangents], pull(jnp.ones_like(value))

    for forward, reverse, wanted in zip(*both_modes(*arguments), expected, strict=True):
        np.testing.assert_allclose(forward, wanted, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(reverse, wanted, rtol=1e-9, atol=1e-12)


def test_published_reflectances_of_glass():
    """Index 1.5, unpolarised, as tables of reflectances print them to four digits."""
    c = np.cos(np.radians([0, 45, 60, 75, 85]))
    exact, schlick = optics.fresnel_dielectric(c, 1.5), optics.fresnel_schlick(c, 1.5)
    np.testing.assert_allclose(exact, [0.0400, 0.0502, 0.0892, 0.2531, 0.6128], rtol=0, atol=5e-5)
    np.testing.assert_allclose(schlick, [0.0400, 0.0421, 0.0700, 0.2547, 0.6485], rtol=0, atol=5e-5)


def test_known_angles_and_lengths():
    assert np.degrees(optics.critical_angle(1 / 1.5)) == pytest.approx(41.8103, abs=1e-4)
    assert np.degrees(optics.snell_angle(np.radians(30), 1.5)) == pytest.approx(19.4712, abs=1e-4)
    # Descartes' rainbows: water, turned by 138 and 231 degrees, seen at 42 and 51 from the point opposite to the sun.
    for k, seen in ((1, 42.08), (2, 50.89), (3, 138.26)):
        turned = np.degrees(optics.sphere_deviation(optics.rainbow_incidence(1.333, k), 1.333, k))
        assert abs(180 - turned) == pytest.approx(seen, abs=0.05)
        assert np.degrees(optics.rainbow_angle(1.333, k)) == pytest.approx(seen, abs=0.05)
    assert np.degrees(optics.rainbow_incidence(1.333)) == pytest.approx(59.41, abs=0.01)
    assert np.degrees(optics.brewster_angle(1.5)) == pytest.approx(56.31, abs=0.005)
    # A slab of 10 mm at 45 degrees, and a prism of 60 degrees in its least deviation.
    assert optics.slab_shift(np.pi / 4, 1.5, 10.0) == pytest.approx(3.291, abs=5e-4)
    least = optics.prism_deviation(np.arcsin(1.5 / 2), 1.5, np.pi / 3)
    assert np.degrees(least) == pytest.approx(37.18, abs=0.005)
    assert optics.prism_least_deviation(1.5, np.pi / 3) == pytest.approx(float(least), rel=1e-12)
    assert optics.prism_index(least, np.pi / 3) == pytest.approx(1.5, rel=1e-12)
    # A thin lens; half a ball with its flat side behind, whose focus lies f / eta behind it; and a whole one.
    assert optics.lensmaker_focal_length(0.5, -0.25, 1.5) == pytest.approx((8 / 3, 8 / 3))
    assert optics.lensmaker_focal_length(1.0, 0.0, 1.5, 1.0) == pytest.approx((2, 4 / 3))
    assert optics.lensmaker_focal_length(0.5, -0.5, 1.5, 4.0) == pytest.approx((3, 1))
    assert np.isfinite(jax.grad(focal)(0.5, 0.5, 1.5, 0.0))
    # A glass ball focuses half of its radius behind itself; at index two on its back.
    assert optics.lens_focal_length(2.0, 1.5) == (3, 1)
    assert optics.lens_focal_length(2.0, 2.0).back == 0


@given(theta_i=ANGLES, eta=ETAS)
def test_snell_and_the_way_back(theta_i, eta):
    theta_t = optics.snell_angle(theta_i, eta)
    if np.sin(theta_i) >= eta:
        assert theta_t == np.pi / 2
        return
    assert eta * np.sin(theta_t) == pytest.approx(np.sin(theta_i), abs=1e-12)
    assert optics.snell_angle(-theta_i, eta) == -theta_t
    if theta_t < 1.55:
        assert optics.snell_angle(theta_t, 1 / eta) == pytest.approx(theta_i, abs=1e-9)


@given(theta_i=ANGLES, eta=ETAS)
def test_the_angle_is_of_the_refracted_ray(theta_i, eta):
    d = jnp.stack([jnp.sin(theta_i), -jnp.cos(theta_i), jnp.zeros(())])
    _, cos_theta_t, total = optics.refract(d, jnp.asarray([0.0, 1, 0]), jnp.asarray(eta))
    assert np.cos(optics.snell_angle(theta_i, eta)) == pytest.approx(float(cos_theta_t), abs=1e-7)
    if abs(np.sin(theta_i) - eta) > 1e-12:
        assert bool(total) == (eta <= 1 and theta_i > optics.critical_angle(eta))


@given(theta_i=ANGLES, eta=ETAS)
def test_a_surface_conserves_light(theta_i, eta):
    c = np.cos(theta_i)
    parallel, perpendicular = optics.fresnel_amplitudes(c, eta)
    r = optics.fresnel_dielectric(c, eta)
    assert 0 <= r <= 1 and abs(parallel) <= 1 and abs(perpendicular) <= 1
    theta_t = optics.snell_angle(theta_i, eta)
    if theta_t == np.pi / 2:
        assert r == 1
    elif theta_t < 1.55:
        assert optics.fresnel_dielectric(np.cos(theta_t), 1 / eta) == pytest.approx(float(r), abs=1e-9)
        # Stokes: the amplitudes from behind are those from in front with the opposite sign.
        behind = optics.fresnel_amplitudes(np.cos(theta_t), 1 / eta)
        np.testing.assert_allclose(behind, (-parallel, -perpendicular), atol=1e-9)
        # What is transmitted takes the rest: the amplitudes of transmission are those that continuity asks for.
        t = np.cos(theta_t)
        shares = [(2 * c / (c + eta * t)) ** 2, (2 * c / (eta * c + t)) ** 2]
        assert r + eta * t / c * np.mean(shares) == pytest.approx(1, abs=1e-9)


@given(eta=st.floats(0.35, 3.0))
def test_brewsters_angle_reflects_no_p_light(eta):
    parallel, perpendicular = optics.fresnel_amplitudes(np.cos(optics.brewster_angle(eta)), eta)
    assert abs(parallel) < 1e-12
    assert perpendicular == pytest.approx((1 - eta**2) / (1 + eta**2), abs=1e-12)


@given(theta_i=ANGLES, eta=st.floats(1.05, 2.5), k=st.integers(0, 3))
def test_the_deviation_matches_a_traced_ray(theta_i, eta, k):
    p = np.array([-np.cos(theta_i), np.sin(theta_i), 0])
    d, turned = jnp.asarray([1.0, 0, 0]), 0.0

    def step(new):
        # Clockwise, towards the axis, is positive; no single turn reaches a half circle.
        nonlocal d, turned
        turned -= np.arctan2(float(d[0] * new[1] - d[1] * new[0]), float(d @ new))
        d = new

    step(optics.refract(d, jnp.asarray(p), jnp.asarray(eta))[0])
    for inner in range(k + 1):
        p = p - 2 * float(d @ p) * np.asarray(d)
        last = inner == k
        step(optics.refract(d, jnp.asarray(p), jnp.asarray(1 / eta))[0] if last else optics.reflect(d, jnp.asarray(p)))
    # A ray through the centre turns back by pi: either way round is the same.
    difference = (turned - float(optics.sphere_deviation(theta_i, eta, k)) + np.pi) % (2 * np.pi) - np.pi
    assert difference == pytest.approx(0, abs=1e-7)


@pytest.mark.slow
@given(eta=st.floats(1.01, 1.99), k=st.integers(1, 3))
def test_the_rainbow_has_minimum_deviation(eta, k):
    theta_i = optics.rainbow_incidence(eta, k)
    assert jax.grad(optics.sphere_deviation)(theta_i, eta, k) == pytest.approx(0, abs=1e-6)
    angles = np.linspace(0, np.pi / 2, 200)
    assert np.all(optics.sphere_deviation(angles, eta, k) >= optics.sphere_deviation(theta_i, eta, k) - 1e-9)


@given(radius=st.floats(0.1, 10), eta=st.floats(1.1, 2.9))
def test_a_ball_focuses_rays_near_its_axis(radius, eta):
    height = 1e-4 * radius
    theta_i = np.arcsin(height / radius)
    turned = float(optics.sphere_deviation(theta_i, eta))
    # A ray at some height that turns by an angle as if at the ball's centre meets the axis at the focal length.
    assert height / np.tan(turned) == pytest.approx(float(optics.lens_focal_length(radius, eta).effective), rel=1e-6)


TOTAL = {
    "snell_angle": (optics.snell_angle, (0.9, 0.7), np.pi / 2, (0, 0)),
    "critical_angle_at_one": (optics.critical_angle, (1.0,), np.pi / 2, (0,)),
    "fresnel_dielectric": (optics.fresnel_dielectric, (0.5, 0.7), 1, (0, 0)),
    "sphere_deviation": (optics.sphere_deviation, (0.9, 0.7), 1.8 - np.pi, (2, 0)),
    "last_rainbow": (optics.rainbow_incidence, (2.0,), 0, (0,)),
    "first_rainbow": (optics.rainbow_incidence, (1.0,), np.pi / 2, (0,)),
    "grazing": (optics.snell_angle, (np.pi / 2, 1.0), np.pi / 2, (0, 0)),
    "grazing_reflectance": (optics.fresnel_dielectric, (0.0, 1.0), 1, (0, 0)),
    "grazing_from_inside": (optics.fresnel_dielectric, (0.0, 0.7), 1, (0, 0)),
    "no_lens": (effective, (2.0, 1.0), 1e6 + 1, (5e5 + 0.5, 0)),
}


@pytest.mark.parametrize("name", TOTAL)
def test_values_beyond_limits_are_as_stated(name):
    function, arguments, value, slopes = TOTAL[name]
    places = tuple(range(len(arguments)))
    found, gradient = jax.value_and_grad(function, places)(*arguments)
    np.testing.assert_allclose(found, value, rtol=1e-12)
    np.testing.assert_allclose(gradient, slopes, rtol=1e-12)
    np.testing.assert_allclose(jax.jacfwd(function, places)(*arguments), slopes, rtol=1e-12)


@pytest.mark.parametrize("distance", [1e-3, 1e-6, 1e-9, 1e-12, 0.0, -1e-12, -1e-9, -1e-3])
def test_values_join_at_the_critical_angle(distance):
    eta = 0.7
    theta_i = optics.critical_angle(eta) - distance
    near = 3 * np.sqrt(abs(distance)) + 1e-7  # Both tend to their limits like a square root.
    for function, argument, limit, scale in (
        (optics.snell_angle, theta_i, np.pi / 2, 1),
        (optics.fresnel_dielectric, jnp.cos(theta_i), 1, 4),
    ):
        value, slopes = jax.value_and_grad(function, (0, 1))(argument, eta)
        assert abs(value - limit) <= scale * near
        assert np.isfinite(slopes).all()
        if distance >= 1e-9:
            assert np.abs(slopes[0]) > 0.3 / np.sqrt(distance)


def test_arguments_broadcast():
    angles, etas = np.linspace(0, 1.5, 4)[:, None], np.linspace(0.5, 2, 3)
    table = optics.snell_angle(angles, etas)
    assert table.shape == optics.fresnel_dielectric(np.cos(angles), etas).shape == (4, 3)
    assert table[2, 1] == pytest.approx(float(optics.snell_angle(float(angles[2, 0]), float(etas[1]))), rel=1e-14)
    assert optics.sphere_deviation(np.float32(0.5), jnp.float32(1.5)).dtype == np.float32


def test_bad_reflection_counts_are_refused():
    with pytest.raises(ValueError, match="internal_reflections is -1; it can be 0 or more"):
        optics.sphere_deviation(0.5, 1.5, -1)
    with pytest.raises(ValueError, match="internal_reflections is 0; it can be 1 or more"):
        optics.rainbow_angle(1.5, 0)


UNDEFINED = {
    "fresnel_dielectric": (optics.fresnel_dielectric, (-0.5, 1.5), "cos_theta_i is -0.5, and 0 to 1 is wanted"),
    "fresnel_amplitudes": (parallel, (-1e-3, 1.5), "cos_theta_i is -0.001, and 0 to 1"),
    "fresnel_schlick": (optics.fresnel_schlick, (-0.5, 1.5), "cos_theta is -0.5, and 0 to 1 is wanted"),
    "a cosine above 1": (optics.fresnel_dielectric, (1.01, 1.5), "cos_theta_i is 1.01, and 0 to 1 is wanted"),
    "an index of 0": (optics.fresnel_dielectric, (0.5, 0.0), "eta is 0, and more than 0 is wanted"),
    "degrees": (optics.snell_angle, (30.0, 1.5), "theta_i is 30, and -pi / 2 to pi / 2 is wanted, in radians"),
    "critical_angle": (optics.critical_angle, (1.5,), "eta is 1.5, and 1 at most is wanted"),
    "rainbow_angle": (optics.rainbow_angle, (2.5,), "eta is 2.5, and 1 to 2 is wanted"),
    "rainbow_incidence": (optics.rainbow_incidence, (0.8,), "eta is 0.8, and 1 to 2 is wanted"),
    "slab_shift": (optics.slab_shift, (0.9, 0.7, 1.0), "theta_i is 0.9, and the reflection is total there"),
    "prism_deviation": (optics.prism_deviation, (0.1, 1.5, 1.0), "and no ray leaves by the second face"),
    "prism_least_deviation": (optics.prism_least_deviation, (2.5, 1.0), "is 1.19856, and less than 1 is wanted"),
    "prism_index": (optics.prism_index, (2.5, 1.0), "apex is 3.5, and 0 to pi is wanted"),
}
"""A function, arguments for which it says nothing, and what it says of them."""


@pytest.mark.parametrize("name", UNDEFINED)
def test_undefined_values_are_refused_or_nan(name):
    function, arguments, words = UNDEFINED[name]
    with pytest.raises(RaytraceError, match=words):
        function(*arguments)
    # One wrong value among others.
    right = next((cases[0] for one, _, cases in FORMULAS.values() if one is function), (0.5, 1.5))
    both = tuple(np.stack(pair) for pair in zip(right, arguments, strict=True))
    with pytest.raises(RaytraceError, match=words):
        function(*both)
    with jax.debug_nans(False):
        values = jax.jit(function)(*both)
        assert np.isfinite(values[0]) and np.isnan(values[1])
        slopes = jax.jit(jax.vmap(jax.grad(function, tuple(range(len(both))))))(*both)
        for slope in slopes:
            assert np.isfinite(slope[0]) and np.isnan(slope[1])
    with pytest.raises(RaytraceError, match=words):
        jax.grad(function)(*arguments)
