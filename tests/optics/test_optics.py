"""The laws of reflection and refraction, and their derivatives where square roots are steep."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax import optics
from raytrace_jax.optics.fresnel import reflected_share

# Each is one program, not one for each of its operations.
fresnel_schlick, reflect, refract = map(jax.jit, (optics.fresnel_schlick, optics.reflect, optics.refract))
SEEDS = st.integers(0, 2**32 - 1)
COUNT = 64


def unit(random, count=COUNT):
    v = random.normal(size=(3, count))
    return jnp.asarray(v / np.linalg.norm(v, axis=0))


def random_case(seed):
    """Directions, normals and ratios of indices; about half of the directions come from behind the surface."""
    random = np.random.default_rng(seed)
    return unit(random), unit(random), jnp.asarray(random.uniform(0.4, 2.5, COUNT))


def at_angle(theta, eta):
    """One ray that meets the surface y = 0 from above at an angle to its normal."""
    theta = jnp.atleast_1d(theta)
    d = jnp.stack([jnp.sin(theta), -jnp.cos(theta), 0 * theta])
    n = jnp.stack([0 * theta, 1 + 0 * theta, 0 * theta])
    return d, n, jnp.full(theta.shape, eta)


def inner(a, b):
    return np.sum(np.asarray(a) * np.asarray(b), axis=0)


@given(seed=SEEDS)
def test_reflection_is_an_involution(seed):
    d, n, _ = random_case(seed)
    r = reflect(d, n)
    np.testing.assert_allclose(inner(r, r), 1, atol=1e-14)
    np.testing.assert_allclose(inner(r, n), -inner(d, n), atol=1e-14)
    np.testing.assert_allclose(reflect(r, n), d, atol=1e-14)
    np.testing.assert_array_equal(reflect(d, -n), r)


@given(seed=SEEDS)
def test_snell(seed):
    d, n, eta = random_case(seed)
    t, cos_theta_t, total = refract(d, n, eta)
    sin_i, sin_t = (np.linalg.norm(np.cross(v, n, axis=0), axis=0) for v in (d, t))
    some = ~np.asarray(total)
    assert some.any()
    np.testing.assert_allclose((sin_t * eta)[some], sin_i[some], atol=1e-13)
    np.testing.assert_allclose(inner(t, t)[some], 1, atol=1e-13)
    np.testing.assert_allclose(np.abs(inner(t, n))[some], cos_theta_t[some], atol=1e-13)
    assert np.all((inner(t, n) * inner(d, n))[some] >= 0)  # to the other side, never back
    # In the plane of incidence.
    np.testing.assert_allclose(inner(np.cross(d, n, axis=0), t)[some], 0, atol=1e-13)


@given(seed=SEEDS)
def test_light_goes_back_the_way_it_came(seed):
    d, n, eta = random_case(seed)
    t, cos_theta_t, total = refract(d, n, eta)
    back, cos_back, back_total = refract(-t, n, 1 / eta)
    # Not at grazing incidence, where a cosine from a square root near zero has lost half of its digits.
    some = ~np.asarray(total) & (np.asarray(cos_theta_t) > 1e-3) & (np.abs(inner(d, n)) > 1e-3)
    assert not np.asarray(back_total)[some].any()
    np.testing.assert_allclose(np.asarray(back)[:, some], -np.asarray(d)[:, some], atol=1e-11)
    np.testing.assert_allclose(cos_back[some], np.abs(inner(d, n))[some], atol=1e-11)


def critical_pair(distance, eta=0.7):
    """Directions whose radicand is about `distance`: that near to the critical angle."""
    return at_angle(np.arcsin(eta * np.sqrt(1 - distance)), eta)


@pytest.mark.parametrize(
    ("case", "step"),
    [
        (at_angle(0.5, 1.3), 1e-5),
        (at_angle(0.5, 0.8), 1e-5),
        (at_angle(np.pi / 2 - 1e-3, 1.3), 1e-6),  # grazing, into the denser medium
        (at_angle(np.pi / 2 - 1e-3, 1.001), 1e-6),
        (critical_pair(1e-2), 1e-6),
        (critical_pair(1e-3), 1e-7),
        (critical_pair(1e-4), 1e-8),
        (critical_pair(-1e-2), 1e-6),  # beyond the critical angle
    ],
    ids=["middle", "thinner", "grazing", "grazing_thin", "critical2", "critical3", "critical4", "total"],
)
def test_derivatives_are_central_differences(case, step):
    def everything(d, n, eta):
        t, cos_theta_t, _ = refract(d, n, eta)
        return jnp.concatenate([t, cos_theta_t[None], reflect(d, n), fresnel_schlick(cos_theta_t, eta)[None]])

    random = np.random.default_rng(0)
    for _ in range(5):
        tangent = jax.tree.map(lambda x: jnp.asarray(random.normal(size=x.shape)), case)
        ahead, behind = (jax.tree.map(lambda x, v, s=s: x + s * step * v, case, tangent) for s in (1, -1))
        difference = (everything(*ahead) - everything(*behind)) / (2 * step)
        value, forward = jax.jvp(everything, case, tangent)
        scale = np.abs(difference).max()
        np.testing.assert_allclose(forward, difference, atol=1e-6 * scale)

        weights = jnp.asarray(random.normal(size=value.shape))
        reverse = jax.vjp(everything, *case)[1](weights)
        product = sum(float(jnp.vdot(v, g)) for v, g in zip(tangent, reverse, strict=True))
        np.testing.assert_allclose(product, float(jnp.vdot(weights, forward)), rtol=1e-12, atol=1e-12 * scale)


@pytest.mark.parametrize(
    "case",
    [at_angle(np.pi / 2, 1.5), at_angle(0.0, 1.5), at_angle(np.pi / 2, 1.0), critical_pair(0.0), critical_pair(1e-300)],
    ids=["grazing", "normal", "grazing_air", "critical", "nearly_critical"],
)
def test_derivatives_are_finite_at_limits(case):
    for function in (lambda *c: refract(*c)[0], lambda *c: refract(*c)[1]):
        value, pull = jax.vjp(function, *case)
        for leaf in jax.tree.leaves((value, pull(jnp.ones_like(value)))):
            assert np.isfinite(leaf).all()
        for leaf in jax.jvp(function, case, jax.tree.map(jnp.ones_like, case)):
            assert np.isfinite(leaf).all()


@pytest.mark.parametrize("distance", [0.3, 0.02, 0.004, 0.0, -0.004, -0.0099, -0.02])
def test_critical_footprints_are_averaged(distance):
    """The cosine of refraction of a footprint is the mean over it, and so is its derivative."""
    d, n, eta = critical_pair(distance)
    width, parts = 0.02, 100_000
    radicands = distance + width * ((np.arange(parts) + 0.5) / parts - 0.5)
    expected = np.mean(np.sqrt(np.maximum(radicands, 0)))

    def cosine(eta):
        return refract(d, n, eta, jnp.full(1, width * 0.7**2))[1]

    transmitted, found, total = refract(d, n, eta, jnp.full(1, width * 0.7**2))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(inner(transmitted, transmitted), 1)
    assert bool(total[0]) == (distance <= -width / 2)
    ends = np.sqrt(np.maximum(distance + width / 2 * np.array([1, -1]), 0))
    slope = 2 * (1 - distance) / eta  # of the radicand by the ratio of indices
    np.testing.assert_allclose(
        jax.jvp(cosine, (eta,), (jnp.ones(1),))[1], slope * (ends[0] - ends[1]) / width, rtol=1e-9
    )


def test_zero_footprints_refract_as_points():
    d, n, eta = random_case(3)
    point = refract(d, n, eta)
    passes = ~point[2]
    for area, one in zip(refract(d, n, eta, jnp.zeros(COUNT)), point, strict=True):
        np.testing.assert_allclose(area[..., passes], one[..., passes], atol=1e-12)


@pytest.mark.parametrize("off", [-0.7, -0.3, 0.0, 0.3, 0.7, 2.0])
def test_a_share_over_a_range_is_its_mean_also_about_the_critical_angle(off):
    """The range of the squared cosine lies so many of its widths before the critical angle."""
    width, eta, step = 2e-3, 1 / 1.5, 2e-5
    squared = 1 - eta**2 + width * (off + (np.arange(4000) + 0.5) / 4000 - 0.5)

    def share(eta):
        middle = jnp.sqrt(jnp.array([1 - (1 / 1.5) ** 2 + off * width]))
        return reflected_share(middle, eta * jnp.ones(1), jnp.array([width]))[0]

    mean, after, before = (
        np.mean(reflected_share(jnp.sqrt(squared), jnp.full(4000, eta + s * step))) for s in (0, 1, -1)
    )
    assert abs(share(eta) - mean) < 0.01
    for slope in (jax.grad(share)(eta), jax.jvp(share, (eta,), (1.0,))[1]):
        np.testing.assert_allclose(slope, (after - before) / (2 * step), rtol=0.1, atol=1e-9)
