"""What a target's file says of how and by whom it was made is believed, where nobody said otherwise."""

import numpy as np
import OpenEXR
import pytest
from image_files import HEADER_END
from scenes import DATA, assignment_scene

from raytrace_jax import (
    FitOptions,
    RaytraceWarning,
    RenderSettings,
    build,
    load_scene,
    make_scene,
    render,
    write_film,
    write_png,
)
from raytrace_jax.images.pictures import read_origin
from raytrace_jax.images.png import png_chunk
from raytrace_jax.inverse.problem.fixed import with_known_offsets
from raytrace_jax.report.films import how_made
from raytrace_jax.tracer.settings import resolve_settings

LIGHT = np.random.default_rng(0).uniform(0.1, 0.9, (3, 4, 6)).astype(np.float32)
MITSUBA = "Mitsuba version 3.9.1"


def two_balls():
    return make_scene(
        build.camera("eye", pixeldim=(8, 6), viewpoint=(0, 0, 5), lookat=(0, 0, 0)),
        build.material("glass", ior=1.5, alpha=1),
        build.sphere("ball", material="glass", center=(0, -2, 0.5), radius=1),
        build.sphere("other", material="glass", center=(3, 0, 0), radius=0.5),
    )


@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_the_maker_is_read_off_the_file(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    if suffix == ".exr":
        header = {"type": OpenEXR.scanlineimage, "generatedBy": MITSUBA}
        OpenEXR.File(header, dict(zip("RGB", LIGHT, strict=True))).write(str(path))
    else:
        write_png(path, LIGHT)
        assert read_origin(path).maker == ""
        data = path.read_bytes()
        said = png_chunk(b"tEXt", b"generatedBy\0" + MITSUBA.encode())
        path.write_bytes(data[:HEADER_END] + said + data[HEADER_END:])
    assert read_origin(path).maker == MITSUBA


def test_mitsuba_makes_radii_uncertain():
    scene, free = two_balls(), ["ball.center.x", "glass.ior"]
    with pytest.warns(RaytraceWarning, match=r"uncertain are ball.radius=0\.00036, other.radius=0\.0004;"):
        options = with_known_offsets(FitOptions(), scene, free, MITSUBA)
    # A share of 1500 roundings of one more than the largest coordinate: 1 + 2 + 1, and 1 + 3 + 0.5.
    assert options.uncertain == {"ball.radius": 3.6e-4, "other.radius": 4e-4}
    with pytest.warns(RaytraceWarning, match="other.radius"):
        options = with_known_offsets(FitOptions(uncertain={"ball": "1%"}), scene, free, MITSUBA)
    assert options.uncertain == {"ball": "1%", "other.radius": 4e-4}
    said = FitOptions(uncertain={"spheres": "1%"})
    assert with_known_offsets(said, scene, free, MITSUBA) == said
    assert with_known_offsets(FitOptions(), scene, free, "Mitsuba version 0.6") == FitOptions()
    assert with_known_offsets(FitOptions(), scene, free, "") == FitOptions()


@pytest.mark.parametrize("suffix", ["exr", "png"])
@pytest.mark.parametrize(
    ("how", "wanted"),
    [
        (RenderSettings(size=(8, 6)), {"target_samples": 1}),
        (RenderSettings(size=(8, 6), samples=3), {"target_samples": 3}),
        pytest.param(RenderSettings(size=(8, 6), edges="aware"), {"target_sampling": "aware"}, marks=pytest.mark.slow),
    ],
)
def test_own_files_say_how_they_were_sampled(how, wanted, suffix, tmp_path):
    path, scene = tmp_path / f"a.{suffix}", assignment_scene()
    if suffix == "exr":
        write_film(path, render(scene, how), scene, how)
    else:
        write_png(path, LIGHT, metadata=how_made(scene, resolve_settings(scene, how)))
    said = read_origin(path).how_made
    assert FitOptions().as_made(said) == FitOptions(**wanted)
    for told in (FitOptions(target_sampling="box"), FitOptions(target_samples=4), FitOptions(edges="point")):
        assert told.as_made(said) == told, "what the user says goes first"


@pytest.mark.parametrize("name", ["vitreous", "pov_ball"])
def test_files_of_all_models_say_how(name, tmp_path):
    """Paths of a physical scene have no end, and JSON no infinity."""
    scene = load_scene(DATA / f"{name}.txt")
    write_png(tmp_path / "a.png", LIGHT, metadata=how_made(scene, resolve_settings(scene, RenderSettings(size=(8, 6)))))
    said = read_origin(tmp_path / "a.png").how_made
    assert said["settings"]["path_limit"] == (100 if name == "vitreous" else None)
    assert FitOptions().as_made(said) == FitOptions(target_samples=1)


@pytest.mark.parametrize("said", [{}, {"settings": 3}, {"settings": {"edges": "aware", "samples": 2, "binning": 1}}])
def test_a_silent_file_changes_no_options(said):
    assert FitOptions().as_made(said) == FitOptions()
