"""JAX's own precision, without x64: nothing of what users call makes JAX warn."""

import dataclasses
import os
import subprocess
import sys

import jax
import numpy as np
import pytest
from fake_fit import full_result
from scenes import DATA

from raytrace_jax import RaytraceWarning, load_scene

PROGRAM = """
import importlib.util
import sys
from pathlib import Path

import numpy as np

import raytrace_jax as rj
from raytrace_jax import build

folder = Path(sys.argv[1])
result = rj.FitResult.load(folder / "fit")
assert result.scene.camera.viewpoint.dtype == np.float32, result.scene.camera.viewpoint.dtype
for name in ("vitreous", "bubble", "glass_on_board"):
    scene = rj.load_scene(name)
    again = rj.Scene.from_dict(scene.to_dict(), folder=sys.argv[2])
    assert rj.format_scene(again) == rj.format_scene(scene)
    scene.save(folder / f"{name}.txt")
rj.parse_scene(rj.format_scene(rj.load_scene("vitreous")), dtype=float)
rj.make_scene(
    build.settings("main", model="physical"),
    build.camera("eye", pixeldim=(64, 48), viewpoint=np.zeros(3), lookat=(0, 0, -1.0), fov=np.float64(40)),
    build.material("shine", emission=np.ones(3)),
    build.sphere("ball", material="shine", center=(0.0, 0, -3), radius=1),
)
scene = rj.load_scene("vitreous")
settings = rj.RenderSettings(size=(12, 9), max_bounces=0)
film = rj.render(scene, settings)
assert film.image.dtype == np.float32
rj.render(rj.set_parameters(scene, {"vitreous.center": np.array([4.3, 2.3, -1.0])}), settings)
rj.render(rj.set_parameters(scene, {"film.blur": np.float64(1.0), "film.gain.r": 2}), settings)
derivatives = rj.picture_derivatives(scene, ["cyan.ambient.r"], settings)
assert scene["vitreous.ior"] == rj.list_parameters(scene)["cyan.ior"]
rj.write_film(folder / "film.exr", film, scene, settings)
rj.write_derivatives(folder / "derivatives.exr", derivatives, scene, settings)
rj.write_exr(folder / "a.exr", np.asarray(film.image, np.float64))
rj.write_png(folder / "a.png", film.image)
film.save(folder / "a.ppm")
for name in ("a.exr", "a.png", "a.ppm"):
    rj.read_picture(folder / name)
rj.read_mask(folder / "a.png")
target = np.asarray(film.image, np.float64)
residual = rj.make_residual(scene, target, ["cyan.ambient.r", "film.gain.r"], settings, weights=np.ones((9, 12)))
residual.residual(residual.start, 1.0)
residual.scene_at(residual.start)
rj.export_scene(rj.load_scene("bubble"), folder / "a.xml", "mitsuba")
if importlib.util.find_spec("mitsuba"):
    rj.import_scene(folder / "a.xml")
result.save(folder / "again")
"""


@pytest.mark.slow
def test_jax_warns_of_nothing(tmp_path):
    with jax.enable_x64(True):
        result = dataclasses.replace(full_result(), scene=load_scene("vitreous", dtype=np.float64))
        assert result.scene.camera.viewpoint.dtype == np.float64
        result.save(tmp_path / "fit")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_ENABLE")}
    command = [sys.executable, "-W", "error", "-c", PROGRAM, str(tmp_path), str(DATA)]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_float64_that_is_not_there_is_told():
    with (
        jax.enable_x64(False),
        pytest.warns(RaytraceWarning, match="the scene is in float32: float64 needs jax.config"),
    ):
        assert load_scene("vitreous", dtype=np.float64).camera.viewpoint.dtype == np.float32
