"""Bodies for other renderers: POV-Ray's pictures of them are ours, and Mitsuba's cubes and cylinders come back."""

from pathlib import Path

import numpy as np
import pytest
from body_scenes import HEAD, NESTED, OUTSIDE, PICTURED, SCENES, body_scene

from raytrace_jax import export_scene, import_scene, parse_scene, render

PICTURES = Path(__file__).parents[1] / "physical_pictures" / "pov_bodies.npz"


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURED)
def test_pov_rays_pictures_of_bodies_are_ours(name):
    picture = np.moveaxis(np.load(PICTURES)[name], -1, 0) / 65535
    off = np.abs(np.clip(render(body_scene(name, np.float64)).image, 0, 1) - picture).max(axis=0)
    assert np.mean(off < 2e-5) > 0.999


@pytest.mark.parametrize("name", SCENES)
def test_pov_ray_gets_every_face(name, tmp_path):
    lost = export_scene(body_scene(name), tmp_path / "a.pov", "pov")
    text = (tmp_path / "a.pov").read_text()
    faces = {"box": "plane", "prism": "plane", "rod": "cylinder", "half_ball": "sphere", "biconvex": "sphere"}
    counts = {"box": 6, "prism": 5, "rod": 1, "half_ball": 1, "biconvex": 2}
    if name in faces:
        assert text.count(f"{faces[name]} {{") == counts[name]
    assert text.count("difference") == (name in ("bubble", "pipe", "inside"))
    assert bool(lost) == (name in NESTED) and all(one.startswith("glass within glass") for one in lost)


def test_cubes_and_cylinders_come_back(tmp_path):
    pytest.importorskip("mitsuba")
    box = "box block { material glass center 0.1 -0.05 0.2 right 0.6 0.8 0 up -0.4 0.30004 0 depth 0.5 }"
    rod = "cylinder rod { material flint center 3 0 0.1 axis 0.9 0.5 -0.3 radius 0.35 }"
    scene = parse_scene(f"{HEAD}{OUTSIDE}\n{box}\n{rod}\n", dtype=np.float64)
    assert not export_scene(scene, tmp_path / "a.xml", "mitsuba")
    again, lost = import_scene(tmp_path / "a.xml", dtype=np.float64)
    assert not lost and again.boxes.names == ("block",) and again.cylinders.names == ("rod",)
    for name in ("center", "right", "up", "depth"):
        np.testing.assert_allclose(getattr(again.boxes, name), getattr(scene.boxes, name), atol=1e-12)
    for name in ("center", "axis", "radius"):
        np.testing.assert_allclose(getattr(again.cylinders, name), getattr(scene.cylinders, name), atol=1e-12)
    # A tube without its discs is closed here.
    text = (tmp_path / "a.xml").read_text().replace('type="disk"', 'type="cone"')
    (tmp_path / "b.xml").write_text(text)
    _, lost = import_scene(tmp_path / "b.xml", dtype=np.float64)
    assert "shape rod: an open tube; its ends are closed" in lost


@pytest.mark.parametrize("name", ["prism", "half_disc", "half_ball", "plano_convex"])
def test_what_mitsuba_has_no_form_for_is_named(name, tmp_path):
    lost = export_scene(body_scene(name), tmp_path / "a.xml", "mitsuba")
    assert any(one.startswith("body: ") and "left out" in one for one in lost)
    assert 'id="body"' not in (tmp_path / "a.xml").read_text()
