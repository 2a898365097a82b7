"""Dispersion from corners of a photograph in red, green and blue, of balls and tanks that geometry draws."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from photographed_boards import SIZE, drawn, middles
from PIL import Image
from scipy import ndimage

from raytrace_jax import glass, read_picture
from raytrace_jax.cli.actions.photo_colours import measure_colours, wavelengths_of
from raytrace_jax.cli.console import UsageError
from raytrace_jax.images.jpeg import jpeg_storage
from raytrace_jax.images.transfer import ENCODERS
from raytrace_jax.optics.dispersion import dispersion
from raytrace_jax.photo.colours import WAVELENGTHS, ColourDifferences, colour_differences, joined
from raytrace_jax.photo.geometry import Ball, Camera, Setup, Tank
from raytrace_jax.photo.locate import Located
from raytrace_jax.photo.photograph import Corners
from raytrace_jax.photo.sight import Projection

APART = np.array([-3.6e-3, -0.9e-3, 4.5e-3])
"""How much the index of each channel is off their mean: about that of a crown glass."""
LATERAL = 0.6
"""Pixels by which red is seen farther out than green at the picture's corner, and blue nearer."""
BLUR = 0.8


def corners_of(pixels, places, is_seen):
    inside = is_seen & np.all((pixels > 25) & (pixels < np.array(SIZE) - 26), axis=1)
    return Corners(pixels[inside], places[inside], np.full(inside.sum(), 0.03))


EDGE = 0.55 * SIZE[0]
"""Where in the picture the tank ends: what is farther left is seen through it."""


@pytest.fixture(scope="module", params=["ball", "tank"])
def located(board, request):
    """A camera before a board and a ball or a tank, whose numbers and corners are exact.

    It is turned: edges along the pixels would be drawn less well.
    """
    camera = Camera(np.array([np.pi - 0.2, 0.12, -0.1]), np.array([2.0, -1.0, 262.0]), 35.0)
    ball = Ball(1.52, np.array([4.0, -3.0, 65.0]), 20.0)
    tank = Tank(1.36, np.zeros(3), np.array([0.05, -0.03]), 60.0, 3.0, 1.49, np.zeros(2))
    setup = Setup(camera, tank if request.param == "tank" else ball)
    sight = Projection(setup, SIZE)
    direct = sight.where(board.places)
    through, _, is_seen = sight.where_through(board.places, board.half)
    if request.param == "tank":
        is_beside, is_seen = direct[:, 0] > EDGE + 20, is_seen & (through[:, 0] < EDGE - 20)
    else:
        center, radius = sight.outline
        is_beside = np.linalg.norm(direct - center, axis=1) > radius + 20
    covariance = np.zeros((len(setup.numbers),) * 2)
    covariance[setup.places("index"), setup.places("index")] = 1e-6
    beside, behind = corners_of(direct, board.places, is_beside), corners_of(through, board.places, is_seen)
    return Located(setup, covariance, (0.03, 0.03), beside, behind, board=board, size=SIZE, blur=BLUR)


def light_of(board, setup, pixels):
    """How bright pixels are that see a board through a ball, or in the left of the picture through a tank."""
    if isinstance(setup.glass, Ball):
        return drawn(board, setup.beside, pixels, [setup])
    through = np.nan_to_num(board.brightness(Projection(setup, SIZE).through(pixels).place), nan=0.4)
    beside = drawn(board, setup.beside, pixels)
    return np.where(pixels[:, 0].reshape(beside.shape) < EDGE, through.reshape(beside.shape), beside)


@pytest.fixture(scope="module")
def image(board, located):
    """What the camera sees with each channel's own index and scale, scene-linear."""
    middle, channels = (np.array(SIZE) - 1) / 2, []
    for apart, scale in zip(APART, (LATERAL, 0.0, -LATERAL), strict=True):
        own = dataclasses.replace(located.setup.glass, ior=located.setup.glass.ior + apart)
        setup, light = dataclasses.replace(located.setup, glass=own), 0.0
        # What is seen in a pixel of a larger picture is seen nearer to its middle in the usual one.
        pixels = middle + (middles() - middle) / (1 + scale / np.linalg.norm(middle))
        for off in ((-0.375, -0.125), (-0.125, 0.375), (0.125, -0.375), (0.375, 0.125)):
            light = light + light_of(board, setup, pixels + np.array(off)) / 4
        channels.append(ndimage.gaussian_filter(light, BLUR))
    return 0.8 * np.stack(channels)


def stored(image, path, **how):
    Image.fromarray(np.moveaxis(ENCODERS["srgb"](image), 0, -1)).save(path, quality=92, **how)
    return read_picture(path), jpeg_storage(path)


def test_the_index_of_each_colour_is_read(image, located):
    found = colour_differences(image, located)
    np.testing.assert_allclose(found.of_index, APART, atol=1.5e-4)
    np.testing.assert_allclose(found.lateral, [LATERAL, 0, -LATERAL], atol=0.05)
    assert abs(found.of_index.sum()) < 1e-4 and np.all(np.linalg.eigvalsh(found.covariance) > -1e-15)


def test_what_a_jpeg_did_to_its_colours_is_undone(image, located, tmp_path):
    """Half the colours' pixels take a sixth of a liquid's differences away, half of a ball's."""
    read, storage = stored(image, tmp_path / "half.jpg", subsampling=2)
    assert storage.subsampling == 2
    raw, found = colour_differences(read, located), colour_differences(read, located, storage)
    assert abs(raw.of_index[2] / APART[2]) < 0.88, "the case is worth testing"
    np.testing.assert_allclose(found.of_index, APART, atol=3e-4)
    np.testing.assert_allclose(found.lateral, [LATERAL, 0, -LATERAL], atol=0.1)


def test_a_grey_picture_tells_no_colours(image, located):
    assert colour_differences(np.repeat(image[:1], 3, axis=0), located) is None
    assert colour_differences(image * np.array([1, 1, 0.01])[:, None, None], located) is None, "it has no blue"


@pytest.mark.parametrize(("name", "off"), [("N-BK7", 0.03), ("N-SF66", 0.04), ("S-FPL53", 0.04), ("SCHOTT F2", 0.03)])
def test_abbes_number_follows_from_three_indices(name, off):
    material = glass.named(name)
    exact = [(wavelength, 1e-3) for wavelength, _ in WAVELENGTHS]
    index = np.array([float(material.index(wavelength)) for wavelength, _ in exact])
    differences = ColourDifferences(index - index.mean(), 1e-14 * np.eye(3), np.zeros(3), 0.0)
    found = dispersion(*differences.indices((index.mean(), 1e-6)), exact)
    assert found.n_d == pytest.approx(material.n_d, abs=2e-4)
    assert found.abbe == pytest.approx(material.V_d, rel=off) and found.errors[1] < 0.02 * found.abbe
    # The wavelengths of a usual sensor are known to some nanometres, which is a tenth of Abbe's number.
    usual = dispersion(*differences.indices((index.mean(), 1e-6)), WAVELENGTHS)
    assert 0.07 < usual.errors[1] / usual.abbe < 0.1


def test_an_index_that_is_not_known_well_stays_where_it_is():
    """Its error is common to the channels: misses of their differences must not move it."""
    exact = [(wavelength, 1e-3) for wavelength, _ in WAVELENGTHS]
    for apart in (np.array([1e-4, -2e-4, 1e-4]), np.zeros(3), APART):
        differences = ColourDifferences(apart, 1e-8 * np.eye(3), np.zeros(3), 0.0)
        for wavelengths in (exact, WAVELENGTHS):
            found = dispersion(*differences.indices((1.592, 0.024)), wavelengths)
            assert abs(found.n_d - 1.592) < 4e-3 and found.errors[0] == pytest.approx(0.024, rel=0.05)
            assert found.is_told == (apart is APART)


def test_photographs_of_one_ball_count_by_their_errors():
    near, far = (
        ColourDifferences(APART + off, error**2 * np.eye(3), np.zeros(3), 0.01)
        for off, error in ((0, 1e-4), (3e-4, 3e-4))
    )
    both = joined([near, far])
    np.testing.assert_allclose(both.of_index, APART + 3e-5, rtol=1e-9)
    assert both.covariance[0, 0] == pytest.approx(0.9e-8)


@pytest.mark.parametrize("located", ["tank"], indirect=True)
def test_photographs_tell_one_dispersion(image, located, tmp_path):
    """Of one tank, with less of an error than each; one that was refused tells none, and a JPEG is known as one."""
    noise = 0.03 * np.random.default_rng(4).normal(size=image.shape)
    paths = [tmp_path / name for name in ("half.jpg", "refused.jpg", "all.png")]
    read, storage = stored(image, paths[0], subsampling=2)
    Image.new("RGB", SIZE).save(paths[2])
    images, results = [read, 0 * read, image + noise], [located, None, located]
    together = SimpleNamespace(photographs=[SimpleNamespace(located=result) for result in results])
    both = measure_colours(paths, images, together)
    each = [colour_differences(images[0], located, storage), colour_differences(images[2], located)]
    np.testing.assert_allclose(both.of_index, joined(each).of_index, rtol=1e-9)
    assert np.trace(both.covariance) < 0.8 * min(np.trace(one.covariance) for one in each)
    np.testing.assert_allclose(both.of_index, APART, atol=2e-4)
    assert measure_colours(paths[1:2], images[1:2], SimpleNamespace(photographs=together.photographs[1:2])) is None


def test_wavelengths_are_read_or_refused():
    assert wavelengths_of(None) == WAVELENGTHS and wavelengths_of("589") == [(589.0, 0.0)]
    assert wavelengths_of("610+-5,550,465+-2") == [(610.0, 5.0), (550.0, 0.0), (465.0, 2.0)]
    for text in ("610,550", "0.6,0.5,0.4", "red,green,blue", "589+-"):
        with pytest.raises(UsageError, match=r"--wavelengths: .* nanometres are wanted"):
            wavelengths_of(text)
