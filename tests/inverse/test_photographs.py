"""Targets from cameras: pixels that tell no light, painted masks, crops, and what EXIF tells of the lens."""

import importlib.util
import io

import numpy as np
import pytest
from image_files import jpeg, photo, write_tiff
from PIL import Image
from scenes import DATA, assignment_scene

from raytrace_jax import (
    FitResult,
    PictureError,
    RenderSettings,
    build,
    load_scene,
    make_scene,
    read_mask,
    read_picture,
    write_exr,
    write_png,
)
from raytrace_jax.cli import main
from raytrace_jax.cli.actions.fit import read_targets, seen_part, with_angle_of_view
from raytrace_jax.cli.options.fits import Fit
from raytrace_jax.images.masks import clipped_pixels
from raytrace_jax.scene.structs import USUAL_FOV
from raytrace_jax.tracer.settings import resolve_settings

LIGHT = np.random.default_rng(0).uniform(0.1, 0.9, (3, 12, 16))
SATURATED, BLACK = (0, 3, 4), (1, 7, 9)
ENDS = LIGHT.copy()
ENDS[SATURATED], ENDS[BLACK] = 1.5, 0.0


def stored(path, transfer="srgb"):
    """The picture, whose two pixels at the ends are a channel's, in a file of the format of its name."""
    if path.suffix == ".exr":
        write_exr(path, dict(zip("RGB", ENDS.astype(np.float32), strict=True)))
        return path
    write_png(path.with_suffix(".png"), ENDS, transfer=transfer)
    pixels = np.asarray(Image.open(path.with_suffix(".png")))
    if path.suffix == ".tif":
        write_tiff(path, pixels)
    if path.suffix == ".jpg":
        path.write_bytes(jpeg(np.kron(pixels, np.ones((8, 8, 1), np.uint8)), quality=100))
    return path


@pytest.mark.parametrize("transfer", ["srgb", "course"])
@pytest.mark.parametrize(
    ("name", "how", "clamps", "wanted"),
    [
        ("a.tif", "auto", True, (1, 1)),
        ("a.jpg", "auto", False, (64, 64)),
        ("a.png", "auto", True, (0, 0)),
        ("a.png", "drop", True, (1, 1)),
        ("a.tif", "keep", False, (0, 0)),
        ("a.exr", "drop", False, (0, 0)),
    ],
)
def test_clipped_pixels_tell_no_light(name, how, clamps, wanted, transfer, tmp_path):
    path = stored(tmp_path / name, transfer)
    picture = read_picture(path, transfer=transfer)
    found = clipped_pixels(path, picture, how, clamps)
    assert (found.saturated.sum(), found.black.sum()) == wanted
    times = picture.shape[-1] // 16
    assert not wanted[0] or found.saturated[SATURATED[1] * times, SATURATED[2] * times]
    assert not wanted[1] or found.black[BLACK[1] * times, BLACK[2] * times]
    assert found.weights.sum() == found.weights.size - sum(wanted)
    assert bool(found.words(path)) == bool(sum(wanted))


PAINTED = np.zeros((12, 16), np.uint8)
PAINTED[4:9, 5:11] = 255


def painted_png(image, **options):
    file = io.BytesIO()
    image.save(file, "PNG", **options)
    return file.getvalue()


def layer():
    """White paint on a transparent layer."""
    pixels = np.zeros((12, 16, 4), np.uint8)
    pixels[4:9, 5:11] = [255, 255, 255, 255]
    return Image.fromarray(pixels)


@pytest.mark.parametrize(
    "content",
    [
        painted_png(Image.fromarray(PAINTED)),
        painted_png(Image.fromarray(PAINTED > 0)),
        painted_png(Image.fromarray(np.dstack([PAINTED] * 3))),
        painted_png(Image.fromarray(np.dstack([PAINTED] * 3)).quantize(2)),
        painted_png(layer()),
        jpeg(np.dstack([PAINTED] * 3), quality=95),
    ],
    ids=["gray", "bits", "rgb", "palette", "layer", "jpeg"],
)
def test_a_painted_mask_is_bright_and_opaque(content, tmp_path):
    path = tmp_path / "mask"
    path.write_bytes(content)
    found = read_mask(path)
    if content[:2] == b"\xff\xd8":  # A JPEG rings around what is painted.
        assert np.mean(found[PAINTED > 0]) > 0.95 and np.mean(found[PAINTED == 0] == 0) > 0.6
    else:
        np.testing.assert_array_equal(found, PAINTED / 255)


def test_masks_of_other_files_are_weights(tmp_path):
    weights = np.random.default_rng(1).uniform(0, 3, (12, 16)).astype(np.float32)
    write_exr(tmp_path / "mask.exr", dict.fromkeys("RGB", weights))
    np.testing.assert_allclose(read_mask(tmp_path / "mask.exr"), weights, rtol=1e-6)
    write_tiff(tmp_path / "mask.tif", (PAINTED[..., None].astype(np.uint16) * 257))
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.tif"), PAINTED / 255)
    half = np.dstack([np.full((12, 16, 3), 255, np.uint8), PAINTED // 2])
    Image.fromarray(half).save(tmp_path / "half.png")
    np.testing.assert_allclose(read_mask(tmp_path / "half.png"), PAINTED // 2 / 255)


def test_broken_masks_are_refused(tmp_path):
    (tmp_path / "mask.jpg").write_bytes(jpeg(np.dstack([PAINTED] * 3))[:200])
    with pytest.raises(PictureError, match=r"mask.jpg: cannot be read"):
        read_mask(tmp_path / "mask.jpg")
    with pytest.raises(PictureError, match=r"mask.png"):
        read_mask(tmp_path / "mask.png")


SETTINGS = RenderSettings(size=(16, 12), crop=(2, 3, 8, 6), max_bounces=1)


def resolved(scene):
    return resolve_settings(scene, SETTINGS)


def test_a_whole_target_is_cropped():
    scene = assignment_scene()
    np.testing.assert_array_equal(seen_part(LIGHT, scene, resolved(scene), "the target"), LIGHT[:, 3:9, 2:10])
    part = LIGHT[:, :6, :8]
    np.testing.assert_array_equal(seen_part(part, scene, resolved(scene), "the target"), part)
    np.testing.assert_array_equal(seen_part(PAINTED, scene, resolved(scene), "the mask"), PAINTED[3:9, 2:10])
    wanted = "the mask is 15 x 12 pixels; wanted is the size of the whole picture, 16 x 12, or that of the crop, 8 x 6"
    with pytest.raises(PictureError, match=wanted):
        seen_part(PAINTED[:, :-1], scene, resolved(scene), "the mask")


def test_target_and_mask_are_cropped(tmp_path, capsys):
    scene, path = assignment_scene(), stored(tmp_path / "a.tif")
    Image.fromarray(np.full((12, 16), 51, np.uint8)).save(tmp_path / "mask.png")
    files = {"scene": tmp_path / "scene.txt", "target": (str(path),), "mask": (str(tmp_path / "mask.png"),)}
    command, camera = Fit(**files, output=tmp_path, free=("vitreous.ior",), transfer=("srgb",)), scene.camera.name
    read = read_targets(command, command.files([camera]), scene, {camera: resolved(scene)})
    target, weights = read["target"][camera], read["weights"][camera]
    assert target.shape == (3, 6, 8)
    assert weights[0, 2] == 0 and weights[4, 7] == 0, "the saturated and the black one"
    assert np.sum(weights == 0.2) == 46
    assert "1 saturated and 1 black of 48 pixels have no weight" in capsys.readouterr().err


def camera_scene(**values):
    return make_scene(
        build.camera("eye", pixeldim=(48, 32), viewpoint=(0, 0, 5), lookat=(0, 0, 0), **values),
        build.material("glass", ior=1.5, alpha=1),
        build.sphere("ball", material="glass", center=(0, 0, 0), radius=1),
    )


def test_a_fit_begins_at_the_exif_fov(tmp_path, capsys):
    path = photo(tmp_path / "a.jpg", FocalLengthIn35mmFilm=28)
    scene = camera_scene()
    assert float(scene["eye.fov"]) == pytest.approx(USUAL_FOV)
    assert float(with_angle_of_view(scene, path, ())["eye.fov"]) == pytest.approx(65.47, abs=0.02)
    assert "eye.fov begins there" in capsys.readouterr().err
    for stated, assignments in ((camera_scene(fov=30), ()), (scene, ("eye.fov=39.6",))):
        assert with_angle_of_view(stated, path, assignments) is stated
        assert "tells an angle of view of 65.47 degrees; eye.fov is" in capsys.readouterr().err
    near = photo(tmp_path / "b.jpg", FocalLengthIn35mmFilm=50)
    assert with_angle_of_view(scene, near, ()) is scene and not capsys.readouterr().err


PHOTOGRAPHED = DATA.parent / "tests" / "physical_pictures" / "photographed_ball"
CAMERA = {"film.gain.r": 0.97, "film.gain.g": 0.88, "film.gain.b": 0.8, "film.blur": 1.1, "film.vignetting": 0.04}


@pytest.fixture(scope="module")
def photograph(tmp_path_factory):
    """POV-Ray's picture of a ball, taken by a camera in NumPy: a JPEG of quality 90, with noise."""
    spec = importlib.util.spec_from_file_location("chain", DATA.parent / "experiments" / "camera" / "chain.py")
    chain = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(chain)
    gains = tuple(CAMERA[f"film.gain.{channel}"] for channel in "rgb")
    camera = chain.Chain(psf=1.1, gains=gains, vignetting=0.04, full_well=15_000, read_noise=8, quality=90, seed=1)
    path = tmp_path_factory.mktemp("photo") / "photo.jpg"
    chain.photograph(read_picture(PHOTOGRAPHED.with_suffix(".exr")), camera, path)
    return path


@pytest.mark.slow
@pytest.mark.optimized
def test_a_photograph_gives_index_and_camera(photograph, tmp_path):
    guess, free = (
        f"{PHOTOGRAPHED}_guess.txt",
        ["ball0.ior", "ball0.center", "film.gain", "film.blur", "film.vignetting"],
    )
    command = ["fit", guess, str(photograph), "--free", *free, "--no-search", "-o", str(tmp_path), "--quiet"]
    assert main(command) in (0, 3)
    found = FitResult.load(tmp_path)
    truth = load_scene(f"{PHOTOGRAPHED}_truth.txt")
    off = abs(found["ball0.ior"].value - float(truth["ball0.ior"]))
    assert off < 2e-4 and off < 3 * found["ball0.ior"].error
    for name, value in CAMERA.items():
        assert abs(found[name].value - value) < 3 * found[name].error, name
    # The fitted scene has the film, so that it renders what was photographed.
    fitted = load_scene(tmp_path / "fit.txt")
    assert float(fitted["film.blur"]) == pytest.approx(found["film.blur"].value, rel=1e-6)
