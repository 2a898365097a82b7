"""Glass that is no single ball: a water surface, a slab, a camera within, glass that overlaps; against POV-Ray."""

import dataclasses
import shutil
import subprocess

import numpy as np
import pytest

import raytrace_jax as rj
from raytrace_jax import build

SIZE = (96, 72)
AS_PHYSICAL = rj.RenderSettings(model="physical", size=SIZE)
FINISH = "finish { ambient 0 diffuse 0 reflection { 0, 1 fresnel on } conserve_energy }"
GLASS = f"pigment {{ rgbt 1 }} {FINISH} interior {{ ior %s }}"

CHECKER = {"kind": "checker", "color1": (0.1, 0.2, 0.3), "color2": (0.9, 0.7, 0.5), "square": 0.5}
CHECKER |= {"offset": (0.13, 0.07)}
ROWS, COLUMNS = np.mgrid[:64, :64] / 63
WAVES = np.stack([ROWS, COLUMNS, 0.5 + 0.4 * np.sin(3 * ROWS + 2 * COLUMNS)])
SMOOTH = {"kind": "image", "file": WAVES.astype(np.float16)}


def scene(eye, lookat, *shapes, texture=CHECKER):
    """Shapes before one board and above another."""
    return build.make_scene(
        build.camera("eye", pixeldim=SIZE, viewpoint=eye, lookat=lookat, fov=50.0),
        build.background("sky", radiance=(0.3, 0.4, 0.5)),
        build.texture("pattern", **texture),
        build.material("board", emission=(1.0, 1.0, 1.0), texture="pattern"),
        build.material("glass", transmission=1.0, ior=1.5),
        build.material("water", transmission=1.0, ior=1.33),
        build.material("air", transmission=1.0, ior=1.0),
        build.rectangle("back", material="board", center=(0, 0, -3.0), right=(4.0, 0, 0), up=(0, 4.0, 0)),
        build.rectangle("low", material="board", center=(0, -2.0, 0), right=(4.0, 0, 0), up=(0, 0, -4.0)),
        *shapes,
        model="physical",
        dtype=np.float64,
    )


def water(height=-0.6):
    return build.plane("sea", material="water", normal=(0.0, 1.0, 0.0), point=(0.0, height, 0.0))


def slab(ior=1.5):
    """All behind the upper plane is of glass, but for what is behind the lower one: of two planes the first decides."""
    return (
        build.plane("under", material="air", normal=(0.3, 0.0, 1.0), point=(0.0, 0.0, -0.5)),
        build.plane("over", material="glass", normal=(0.3, 0.0, 1.0), point=(0.0, 0.0, 0.3)),
    )


BALL = build.sphere("ball", material="glass", center=(0.0, 0.0, 0.0), radius=1.0)
SCENES = {
    "a water surface": scene((0.0, 1.5, 5.0), (0.0, -0.5, 0.0), water()),
    "a camera under water": scene((0.0, -1.5, 3.0), (0.0, -0.5, -1.0), water()),
    "a camera in a ball": scene((0.2, 0.1, 0.3), (0.0, 0.0, -3.0), BALL),
    "a slab": scene((0.5, 0.6, 5.0), (0.0, -0.2, 0.0), *slab()),
    "overlapping balls": scene(
        (0.4, 0.5, 5.0),
        (0.0, 0.0, 0.0),
        BALL,
        build.sphere("small", material="water", center=(0.7, 0.1, 0.5), radius=0.6),
        texture=SMOOTH,
    ),
}

IN_POV_RAY = {
    "a slab": (
        "// under",
        "intersection { plane { <.3, 0, 1>, 0 translate <0, 0, .3> } plane { <-.3, 0, -1>, 0 translate <0, 0, -.5> } "
        + GLASS % 1.5
        + " }",
    ),
    # Between surfaces that touch POV-Ray loses its way: the smaller ball is larger by a three-thousandth than its hole.
    "overlapping balls": (
        "// ball",
        f"difference {{ sphere {{ 0, 1 }} sphere {{ <.7, .1, .5>, .6 }} {GLASS % 1.5} }} "
        f"sphere {{ <.7, .1, .5>, .6002 {GLASS % 1.33} }}",
    ),
}
"""From which shape on POV-Ray is told what is meant in its own words."""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed")
@pytest.mark.parametrize("name", SCENES)
def test_pov_ray_shows_the_same(name, tmp_path):
    overlaps = name == "overlapping balls"
    # Light goes round and round in two balls, and in POV-Ray a surface that parts nothing counts as a bounce.
    settings = dataclasses.replace(AS_PHYSICAL, max_bounces=40 if overlaps else None)
    rj.export_scene(SCENES[name], tmp_path / "scene.pov", "pov", settings)
    text = (tmp_path / "scene.pov").read_text().replace("max_trace_level 41", "max_trace_level 200")
    if name in IN_POV_RAY:
        start, words = IN_POV_RAY[name]
        (tmp_path / "scene.pov").write_text(text[: text.index(start)] + words)
    command = f"povray +Iscene.pov +Oscene.ppm +W{SIZE[0]} +H{SIZE[1]} +FP16 File_Gamma=1.0 -A -D -GA"
    subprocess.run(command.split(), cwd=tmp_path, check=True, capture_output=True)
    data = (tmp_path / "scene.ppm").read_bytes()[-6 * SIZE[0] * SIZE[1] :]
    theirs = np.frombuffer(data, ">u2").reshape(SIZE[1], SIZE[0], 3).transpose(2, 0, 1) / 65535
    off = np.abs(theirs - np.clip(rj.render(SCENES[name], settings).image, 0, 1)).max(axis=0)
    # The gap shows where light goes round; with the other ball's glass in the overlap four times as many pixels differ.
    close, share = (0.02, 0.025) if overlaps else (2e-5, 0.01)
    assert np.mean(off > close) < share, (np.mean(off > close), off.max())


@pytest.mark.slow
def test_a_slab_shifts_rays_by_snells_law():
    """Straight through the middle a slab of thickness d shifts a ray by d sin(i - t) / cos(t)."""
    thickness, angle = 0.8 / np.hypot(0.3, 1.0), np.arctan(0.3)
    inner = np.arcsin(np.sin(angle) / 1.5)
    expected = thickness * np.sin(angle - inner) / np.cos(inner)
    ramp = {"kind": "image", "file": np.broadcast_to(np.linspace(0, 1, 801), (3, 2, 801)).astype(np.float64)}

    def seen(*shapes):
        made = scene((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), *shapes, texture=ramp)
        made = rj.set_parameters(made, {"eye.fov": 1e-3, "sky.radiance": (0.0, 0.0, 0.0)})
        return float(rj.render(made, rj.RenderSettings(size=(1, 1), max_bounces=2)).image[0, 0, 0])

    reflectance = 0.5 * (
        (np.sin(angle - inner) / np.sin(angle + inner)) ** 2 + (np.tan(angle - inner) / np.tan(angle + inner)) ** 2
    )
    through = seen(*slab()) / (1 - reflectance) ** 2
    place = (through - seen()) * 8 * 800 / 801  # The ramp goes from the middle of the first texel to that of the last.
    assert abs(place) == pytest.approx(expected, rel=2e-3)


@pytest.mark.slow
def test_flat_glass_is_refused_in_words():
    made = scene(
        (0.0, 0.0, 5.0),
        (0.0, 0.0, 0.0),
        build.rectangle("pane", material="glass", center=(0.0, 0.0, 0.0), right=(1.0, 0.0, 0.0), up=(0.0, 1.0, 0.0)),
    )
    for use in (
        lambda: rj.render(made, AS_PHYSICAL),
        lambda: rj.picture_derivatives(made, ["glass.ior"], AS_PHYSICAL),
        lambda: rj.fit(made, np.random.default_rng(0).uniform(size=(3, *SIZE[::-1])), ["glass.ior"], AS_PHYSICAL),
    ):
        with pytest.raises(rj.SceneError, match="rectangle 'pane': its material 'glass' lets light through"):
            use()
    assert np.isfinite(rj.render(rj.set_parameters(made, {"glass.transmission": 0.0}), AS_PHYSICAL).image).all()
