"""Textures: look-ups at points by their formulas, over footprints against brute force, and their derivatives."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from raytrace_jax.tracer.shading.image_texture import environment_colors, image_colors
from raytrace_jax.tracer.shading.image_texture import make_pyramid as pyramid_of
from raytrace_jax.tracer.shading.textures import checker_fraction

RANDOM = np.random.default_rng(0)
WRAPS = ("clamp", "repeat", "black")
KINDS = ("bilinear", "nearest")
# Each is one program, not one for each of its operations.
make_pyramid = jax.jit(pyramid_of, static_argnames="levels")
colors = functools.partial(image_colors, kind="bilinear", wrap="clamp")
over_footprints = at_points = jax.jit(colors, static_argnames=("kind", "wrap"))
checker = jax.jit(checker_fraction)
environment = directions = jax.jit(environment_colors)


def checker_points(position, square, offset):
    return checker(position, None, square, offset)


def smooth_picture(height, width):
    """Waves of a few texels and more."""
    row, column = np.mgrid[0:height, 0:width]
    waves = [np.sin(column / 5 + k) + np.cos(row / 7 - k) + np.sin((row + column) / 11 + 2 * k) for k in range(3)]
    return jnp.asarray(np.stack(waves) / 6 + 0.5)


def footprints(count, size, ratio, angle):
    """Random places well within a picture, and parallelograms of a size, of one shape, turned at random."""
    turn = RANDOM.uniform(0, 2 * np.pi, count)
    first = size * np.stack([np.cos(turn), np.sin(turn)])
    second = size * ratio * np.stack([np.cos(turn + angle), np.sin(turn + angle)])
    return jnp.asarray(RANDOM.uniform(0.3, 0.7, (2, count))), jnp.asarray(np.stack([first, second]))


def brute_force(function, place, axes, n=24):
    """The mean of a function of points over a grid of a parallelogram."""
    s, t = ((np.mgrid[0:n, 0:n].reshape(2, -1, 1) + 0.5) / n - 0.5)[:, None]
    points = place[:, None] + s * axes[0][:, None] + t * axes[1][:, None]
    return jnp.mean(function(points.reshape(2, -1)).reshape(-1, n * n, place.shape[1]), axis=1)


def check_derivative(function, x, *directions, step=1e-6, tolerance=1e-5):
    """Forward and reverse mode against central differences, along each direction."""
    function = jax.jit(function)
    forward_mode = jax.jit(lambda x, direction: jax.jvp(function, (x,), (direction,))[1])
    weights = jnp.asarray(np.random.default_rng(1).normal(size=jax.eval_shape(function, x).shape))
    reverse = jax.jit(jax.grad(lambda x: jnp.vdot(weights, function(x))))(x)
    for direction in directions:
        forward = forward_mode(x, direction)
        difference = (function(x + step * direction) - function(x - step * direction)) / (2 * step)
        np.testing.assert_allclose(forward, difference, atol=tolerance * max(1, np.abs(difference).max()))
        np.testing.assert_allclose(jnp.vdot(reverse, direction), jnp.vdot(weights, forward), rtol=1e-9, atol=1e-9)


# Pictures.


@pytest.mark.parametrize("kind", KINDS)
def test_texels_are_exact_with_row_0_on_top(kind):
    picture = jnp.asarray(RANDOM.random((3, 4, 5)))
    row, column = (jnp.asarray(x.ravel()) for x in np.mgrid[0.0:4, 0:5])
    u, v = (column + 0.5) / 5, 1 - (row + 0.5) / 4
    for wrap in WRAPS:
        found = at_points(make_pyramid(picture, levels=1), u, v, kind=kind, wrap=wrap)
        np.testing.assert_allclose(found.reshape(3, 4, 5), picture, atol=1e-14)


def test_what_lies_beyond_a_picture():
    pyramid = make_pyramid(jnp.asarray(RANDOM.random((3, 4, 5))))
    texels = pyramid.texels[:, :20].reshape(3, 4, 5)
    u, v = jnp.asarray([-0.5, -0.1, 0.0, 1.0]), jnp.full(4, 1 - 2.5 / 4)
    row, zero = texels[:, 2], jnp.zeros(3)
    wanted = {
        "clamp": [row[:, 0], row[:, 0], row[:, 0], row[:, 4]],
        "repeat": [(row[:, 2] + row[:, 2]) / 2, row[:, 4], (row[:, 4] + row[:, 0]) / 2, (row[:, 4] + row[:, 0]) / 2],
        "black": [zero, zero, row[:, 0] / 2, row[:, 4] / 2],
    }
    for wrap, columns in wanted.items():
        np.testing.assert_allclose(at_points(pyramid, u, v, wrap=wrap), jnp.stack(columns, axis=1), atol=1e-14)
    np.testing.assert_allclose(at_points(pyramid, v, u, wrap="black")[:, 0], 0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_shift_by_texels_is_a_roll(kind):
    picture = jnp.asarray(RANDOM.random((3, 6, 8)))
    u, v = jnp.asarray(RANDOM.random((2, 40)))
    rolled = at_points(make_pyramid(jnp.roll(picture, (2, 3), (1, 2))), u, v, kind=kind, wrap="repeat")
    moved = at_points(make_pyramid(picture), u - 3 / 8, v + 2 / 6, kind=kind, wrap="repeat")
    np.testing.assert_allclose(rolled, moved, atol=1e-12)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 5), (16, 16), (37, 32)])
def test_levels_have_one_mean_and_one_centre(size):
    picture = jnp.asarray(RANDOM.random((3, *size)))
    pyramid = make_pyramid(picture)
    assert pyramid.sizes[0] == size and pyramid.sizes[-1] == (1, 1)
    start = 0
    ramp = make_pyramid(jnp.asarray(np.broadcast_to((np.arange(size[1]) + 0.5) / size[1], (3, *size))))
    texels, ramp = np.asarray(pyramid.texels), np.asarray(ramp.texels)
    for height, width in pyramid.sizes:
        level = slice(start, start + height * width)
        np.testing.assert_allclose(texels[:, level].mean(axis=1), np.asarray(picture).mean(axis=(1, 2)), atol=1e-13)
        wanted = np.broadcast_to((np.arange(width) + 0.5) / width, (height, width)).ravel()
        # Of texels of one colour each, in which a ramp has steps; none of its sides is favoured.
        np.testing.assert_allclose(ramp[0, level], wanted, atol=0.15 / size[1] if size[1] % 2 else 1e-13)
        np.testing.assert_allclose(ramp[0, level].mean(), 0.5, atol=1e-13)
        start += height * width
    assert start == texels.shape[1]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("kind", KINDS)
def test_a_footprint_blurs_to_the_mean(kind):
    picture = jnp.asarray(RANDOM.random((3, 9, 14)))
    pyramid = make_pyramid(picture)
    place, axes = footprints(30, 1.0, 0.6, 1.2)
    points = at_points(pyramid, *place, kind=kind, wrap="repeat")
    for size, wanted, error in ((0, points, 1e-14), (1e-9, points, 1e-6), (80, picture.mean((1, 2))[:, None], 1e-12)):
        found = over_footprints(pyramid, *place, size * axes, kind=kind, wrap="repeat")
        np.testing.assert_allclose(found, np.broadcast_to(wanted, found.shape), atol=error)


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "angle"), [(1, np.pi / 2), (1 / 8, np.pi / 2), (0.7, np.pi / 6)])
@pytest.mark.parametrize("texels", [0.3, 3, 12])
def test_picture_means_are_near_brute_force(texels, ratio, angle):
    picture = smooth_picture(90, 75)
    pyramid = make_pyramid(picture)
    place, axes = footprints(60, texels / 75, ratio, angle)

    def exactly(place):
        return brute_force(lambda p: at_points(pyramid, *p), place, axes)

    def nearly(place):
        return over_footprints(pyramid, *place, axes)

    direction = jnp.ones_like(place)
    (wanted, wanted_slope), (found, slope) = (jax.jvp(f, (place,), (direction,)) for f in (exactly, nearly))
    assert np.sqrt(np.mean((found - wanted) ** 2)) < 0.01
    assert np.vdot(slope, wanted_slope) / np.vdot(wanted_slope, wanted_slope) == pytest.approx(1, abs=0.06)


@pytest.mark.parametrize(
    ("kind", "wrap"),
    [("bilinear", "clamp"), *(pytest.param(*both, marks=pytest.mark.slow) for both in itertools.product(KINDS, WRAPS))],
)
def test_coordinate_and_texel_derivatives(kind, wrap):
    picture = jnp.asarray(RANDOM.random((3, 6, 5)))
    place = jnp.asarray(RANDOM.uniform(-0.4, 1.4, (2, 25)))
    _, axes = footprints(25, 0.4, 0.5, 1.3)

    def of_place(place):
        return over_footprints(make_pyramid(picture), *place, axes, kind=kind, wrap=wrap)

    def of_texels(picture):
        return over_footprints(make_pyramid(picture), *place, axes, kind=kind, wrap=wrap)

    def of_points(place):
        return at_points(make_pyramid(picture), *place, kind=kind, wrap=wrap)

    direction = jnp.asarray(RANDOM.normal(size=place.shape))
    check_derivative(of_place, place, direction)
    check_derivative(of_points, place, direction)
    check_derivative(of_texels, picture, jnp.asarray(RANDOM.normal(size=picture.shape)))


# The checker.


def test_the_first_colour_is_at_the_offset():
    position = jnp.asarray([[0.2, 1.0, -0.7, -0.7], [0.1, 0.1, 0.1, -0.7]])
    found = checker_points(position, jnp.asarray(0.8), jnp.asarray([[0.13], [0.07]]))
    np.testing.assert_array_equal(found, [1, 0, 1, 0])


@pytest.mark.parametrize(
    ("ratio", "angle"), [(1, np.pi / 2), (1 / 3, np.pi / 2), (1 / 8, np.pi / 2), (0.7, np.pi / 6), (1, np.pi / 3)]
)
@pytest.mark.parametrize("size", [0.2, 1, 2])
def test_checker_shares_are_near_brute_force(size, ratio, angle):
    square, offset = jnp.asarray(0.5), jnp.asarray([[0.5], [0.0]])
    place, axes = footprints(120, size * 0.5, ratio, angle)  # Around a corner.
    wanted = brute_force(lambda p: checker_points(p, square, offset)[None], place, axes, n=100)[0]
    error = np.abs(checker(place, axes, square, offset) - wanted)
    assert error.max() < 0.025 and np.sqrt(np.mean(error**2)) < 0.006


def test_checker_shares_along_axes_are_exact():
    place = jnp.asarray(RANDOM.uniform(-2, 2, (2, 60)))
    square, offset = jnp.asarray(1.0), jnp.zeros((2, 1))
    # Up to a square wide the mean is a product of ramps.
    width = np.array([0.3, 0.7])[:, None]
    edge = np.round(place)
    ramps = np.clip((place - edge) * 2 / width, -1, 1) * (1 - 2 * (np.abs(edge) % 2))
    axes = jnp.broadcast_to(jnp.asarray(np.diag(width[:, 0]))[..., None], (2, 2, 60))
    np.testing.assert_allclose(checker(place, axes, square, offset), (1 + ramps[0] * ramps[1]) / 2, atol=2e-3)
    # A wide one sees many squares: the mean is a product of differences of the square wave's integral.
    width = np.array([5.3, 6.6])[:, None]
    ends = [1 - np.abs(1 - (place + side * width / 2) % 2) for side in (1, -1)]
    means = (ends[0] - ends[1]) / width
    axes = jnp.asarray(np.broadcast_to(np.diag(width[:, 0])[..., None], (2, 2, 60)))
    np.testing.assert_allclose(checker(place, axes, square, offset), (1 + means[0] * means[1]) / 2, atol=2e-3)
    far = jnp.min(jnp.abs(place - edge), axis=0) > 1e-4
    shrunk = checker(place, 0 * axes, square, offset)
    np.testing.assert_allclose(shrunk[far], checker_points(place, square, offset)[far], atol=1e-8)
    np.testing.assert_allclose(checker(place, 40 * axes, square, offset), 0.5, atol=0.02)


@pytest.mark.slow
def test_checker_derivatives_are_differences():
    place, axes = footprints(40, 0.4, 0.4, 1.1)
    numbers = jnp.asarray([0.31, 0.13, 0.07])
    lengths = np.cumsum([3, place.size])

    def shares(x):
        numbers, place, axes = jnp.split(x, lengths)
        return checker(place.reshape(2, 40), axes.reshape(2, 2, 40), numbers[0], numbers[1:, None])

    x = jnp.concatenate([numbers, place.ravel(), axes.ravel()])
    kind = np.searchsorted(lengths, np.arange(x.size), side="right")
    move = RANDOM.normal(size=x.size)
    check_derivative(shares, x, *jnp.eye(3, x.size), jnp.asarray(move * (kind == 1)), jnp.asarray(move * (kind == 2)))
    shrunk = x.at[lengths[1] :].set(0)
    assert np.isfinite(jax.jit(jax.grad(lambda x: jnp.sum(shares(x) ** 2)))(shrunk)).all()


# The environment.


def test_an_environment_centres_on_minus_z():
    pyramid = make_pyramid(jnp.asarray(RANDOM.random((3, 6, 12))))
    texels = pyramid.texels[:, :72].reshape(3, 6, 12)
    column, row = RANDOM.uniform(0, 11, 50), RANDOM.uniform(0, 5, 50)
    phi, theta = (column + 0.5) / 12 * 2 * np.pi - np.pi, (row + 0.5) / 6 * np.pi
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)])
    c, r = np.floor(column).astype(int), np.floor(row).astype(int)
    right, down = column - c, row - r
    wanted = (1 - down) * ((1 - right) * texels[:, r, c] + right * texels[:, r, c + 1])
    wanted += down * ((1 - right) * texels[:, r + 1, c] + right * texels[:, r + 1, c + 1])
    np.testing.assert_allclose(directions(pyramid, jnp.asarray(d)), wanted, atol=1e-12)
    # Behind, the last and the first column meet.
    behind = directions(pyramid, jnp.asarray([[0.0], [0.0], [1.0]]))[:, 0]
    np.testing.assert_allclose(behind, texels[:, 2:4][:, :, [0, 11]].mean((1, 2)), atol=1e-12)


def environment_picture(height=64):
    """A smooth function on the sphere, as a picture of it."""
    row, column = np.mgrid[0:height, 0 : 2 * height]
    phi, theta = (column + 0.5) / height * np.pi - np.pi, (row + 0.5) / height * np.pi
    return on_sphere(np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)]))


def on_sphere(d):
    return jnp.stack([jnp.sin(9 * d[0] + 4 * d[1]), jnp.cos(8 * d[2] - 5 * d[0]), d[1] * d[0]])


@pytest.mark.slow
def test_environment_means_match_the_sphere():
    pyramid = make_pyramid(environment_picture())
    d = RANDOM.normal(size=(3, 80))
    d[:, :20] = [[0.0], [1.0], [0.0]] + 0.02 * RANDOM.normal(size=(3, 20))
    d /= np.linalg.norm(d, axis=0)
    axes = RANDOM.normal(size=(2, 3, 80))
    axes = 0.15 * (axes - d * (axes * d).sum(1, keepdims=True))
    s, t = (np.mgrid[0:20, 0:20].reshape(2, -1, 1, 1) + 0.5) / 20 - 0.5
    wanted = on_sphere(np.moveaxis(d + s * axes[0] + t * axes[1], 1, 0)).mean(axis=1)
    error = np.asarray(environment(pyramid, jnp.asarray(d), jnp.asarray(axes)) - wanted)
    assert np.sqrt(np.mean(error**2)) < 0.02 and np.abs(error).max() < 0.1
    points = environment(pyramid, jnp.asarray(d), jnp.zeros((2, 3, 80)))
    np.testing.assert_allclose(points, directions(pyramid, jnp.asarray(d)), atol=1e-12)


@pytest.mark.slow
def test_environment_poles_have_derivatives():
    picture = environment_picture(9)
    d = RANDOM.normal(size=(3, 30))
    d = jnp.asarray(d / np.linalg.norm(d, axis=0))
    axes = jnp.asarray(0.2 * RANDOM.normal(size=(2, 3, 30)))
    move = jnp.asarray(RANDOM.normal(size=d.shape))
    check_derivative(lambda d: directions(make_pyramid(picture), d), d, move)
    check_derivative(lambda d: environment(make_pyramid(picture), d, axes), d, move)
    check_derivative(lambda picture: environment(make_pyramid(picture), d, axes), picture, picture**2)
    poles = jnp.asarray([[0.0, 0.0, 1e-8, 0.0], [1.0, -1.0, 1.0, -1.0], [0.0, 0.0, 0.0, -1e-5]])
    for function in (
        lambda d: directions(make_pyramid(picture), d),
        lambda d: environment(make_pyramid(picture), d, jnp.zeros((2, 3, 4))),
    ):
        slopes = jax.jit(jax.grad(lambda d, function=function: jnp.sum(function(d) ** 2)))(poles)
        assert np.isfinite(jax.jit(function)(poles)).all() and np.isfinite(slopes).all()
