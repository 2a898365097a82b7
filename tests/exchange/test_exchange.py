"""Scenes for other renderers: their pictures are ours, and what is lost is named."""

import shutil
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import run
from exchange_scenes import CAMERA, CHECKS, PICTURE, SIZE, board, pane

from raytrace_jax import (
    RenderSettings,
    SceneError,
    build,
    export_scene,
    load_scene,
    read_exr,
    render,
    set_parameters,
)


def test_the_xml_has_the_scene(tmp_path):
    export_scene(board(**CHECKS), tmp_path / "scene.xml", "mitsuba")
    scene = ElementTree.parse(tmp_path / "scene.xml").getroot()

    def numbers(name):
        return {one.get("name"): float(one.get("value")) for one in scene.findall(f"shape[@id='{name}']/bsdf/float")}

    assert numbers("outer") == {"int_ior": 1.62, "ext_ior": 1.0} and numbers("inner")["ext_ior"] == 1.62
    assert scene.find("shape[@id='outer']/bsdf").get("type") == "dielectric"
    assert scene.find("shape[@id='inner']/medium[@name='exterior']").get("type") == "homogeneous"
    assert scene.find("shape/bsdf[@id='steel']").get("type") == "conductor"
    assert scene.find("shape[@id='other']/ref").attrib == {"id": "steel"}
    origin = scene.find("sensor[@id='eye']/transform[@name='to_world']/lookat").get("origin")
    assert tuple(map(float, origin.split(","))) == CAMERA["viewpoint"]
    assert (tmp_path / scene.find("emitter[@id='all']/string[@name='filename']").get("value")).is_file()


def media(path):
    """Of each surface of glass the indices inside and outside, and whether what is there absorbs."""
    root = ElementTree.parse(path).getroot()
    bsdfs = {one.get("id"): one for one in root.iter("bsdf")}
    found = {}
    for shape in root.iter("shape"):
        ref = shape.find("ref")
        bsdf = shape.find("bsdf") if ref is None else bsdfs[ref.get("id")]
        if bsdf.get("type") == "dielectric":
            indices = {one.get("name"): float(one.get("value")) for one in bsdf.iter("float")}
            roles = {one.get("name") for one in shape.iter("medium")}
            found[shape.get("id")] = tuple(
                (indices[f"{side}_ior"], role in roles) for side, role in (("int", "interior"), ("ext", "exterior"))
            )
    return found


AIR, GLASS, WATER = (1.0, False), (1.5, True), (1.25, False)

SURFACES = {
    "slab": {"window air": (AIR, GLASS), "window inside": (GLASS, AIR), "bubble": (AIR, GLASS)},
    "walls": {
        "window air": (AIR, WATER),
        "window back": (WATER, GLASS),
        "window inside": (GLASS, WATER),
        "window front": (WATER, AIR),
        "bubble": (AIR, GLASS),
    },
    "planes": {"behind": (AIR, GLASS), "front": (GLASS, AIR), "bubble": (AIR, GLASS)},
    "oil": {"sea": (WATER, GLASS), "stone": (WATER, GLASS), "bubble": (AIR, WATER)},
}
"""Of the shapes of `pane`, in the words of a file of Mitsuba; found on paper."""


@pytest.mark.parametrize("kind", SURFACES)
def test_surfaces_have_the_media_of_both_sides(kind, tmp_path):
    lost = export_scene(pane(kind), tmp_path / "a.xml", "mitsuba")
    assert media(tmp_path / "a.xml") == SURFACES[kind]
    # Of oil only media say that it absorbs: its plane is the sea's.
    root = ElementTree.parse(tmp_path / "a.xml").getroot()
    assert root.find("integrator").get("type") == "volpath"
    assert len(root.findall("sensor/medium")) == (kind == "oil")
    assert not any("overlap" in one for one in lost)


def test_ids_come_once(tmp_path):
    scene = build.make_scene(
        build.camera("ball", **CAMERA),
        build.background("wall", radiance=(0.5, 0.5, 0.5), texture="wall"),
        build.light("ball", location=(1.0, 2.0, 3.0), emissivity=(1.0, 1.0, 1.0)),
        build.texture("wall", **PICTURE),
        build.material("wall", emission=(1.0, 1.0, 1.0), texture="wall"),
        build.material("glow", emission=(0.5, 0.5, 0.5), texture="wall"),
        build.material("ball", transmission=1.0, ior=1.5),
        *(
            build.rectangle(name, material=of, center=(0.0, 0.0, z), right=(2.0, 0.0, 0.0), up=(0.0, 2.0, 0.0))
            for name, of, z in (("wall", "wall", -2.0), ("glow", "glow", -3.0), ("third", "wall", -4.0))
        ),
        build.sphere("ball", material="ball", center=(0.0, 0.0, 0.0), radius=1.0),
        build.sphere("ball2", material="ball", center=(2.0, 0.0, 0.0), radius=0.4),
        model="physical",
    )
    export_scene(scene, tmp_path / "a.xml", "mitsuba")
    root = ElementTree.parse(tmp_path / "a.xml").getroot()
    ids = [one.get("id") for one in root.iter() if one.tag != "ref" and one.get("id")]
    assert len(ids) == len(set(ids)) and {one.get("id") for one in root.iter("ref")} <= set(ids)
    assert {"ball", "ball.bsdf", "ball.shape", "ball2"} <= set(ids)
    # A picture as the sky, as a board and half as bright: a file each.
    files = {one.get("value") for one in root.iter("string") if one.get("name") == "filename"}
    assert files == {"a.wall.exr", "a.wall.2.exr", "a.wall.3.exr"}
    stored = read_exr(tmp_path / "a.wall.3.exr").channels
    np.testing.assert_array_equal(stored["G"], PICTURE["file"][1] / 2)


LOSSES = {
    "mitsuba": {
        "board: glass that is something else as well": {"emission": (1.0, 1.0, 1.0), "transmission": 1.0},
        "board: a matt surface that is a mirror as well": {"diffuse": (0.5, 0.5, 0.5), "reflectivity": 0.2},
        "board.ior: three indices": {"transmission": 1.0, "ior": (1.5, 1.51, 1.52)},
    },
    "pov": {
        "board: glass that is something else as well": {"transmission": 0.5},
        "board: a matt surface that shines as well": {"diffuse": (0.5, 0.5, 0.5), "emission": (1.0, 1.0, 1.0)},
        "board.absorption": {"transmission": 1.0, "absorption": (0.1, 0.1, 0.1)},
        "board.abbe: dispersion": {"transmission": 1.0, "ior": 1.5, "abbe": 40.0},
    },
}


@pytest.mark.parametrize(("to", "words"), [(to, words) for to, cases in LOSSES.items() for words in cases])
def test_unsupported_features_are_named(to, words, tmp_path):
    scene = build.make_scene(
        build.camera("eye", **CAMERA, distortion=(0.1, 0.0)),
        build.material("board", **LOSSES[to][words]),
        build.sphere("ball", material="board", center=(0.0, 0.0, 0.0), radius=1.0),
        model="physical",
    )
    lost = export_scene(scene, tmp_path / "a", to, RenderSettings(model="physical", path_limit=9.0))
    assert any(one.startswith(words) for one in lost), lost
    assert any(one.startswith("eye.distortion") for one in lost) and any("path_limit" in one for one in lost)
    head = (tmp_path / "a").read_text()
    assert all(one in head for one in lost)


def test_unsupported_geometry_is_named(tmp_path):
    scene = build.make_scene(
        build.camera("eye", **CAMERA),
        build.material("clear", transmission=1.0),
        build.material("matt", diffuse=(1.0, 1.0, 1.0)),
        build.sphere("one", material="clear", center=(0.0, 0.0, 0.0), radius=1.0),
        build.sphere("two", material="clear", center=(1.0, 0.0, 0.0), radius=1.0),
        build.plane("floor", material="matt", normal=(0.0, 1.0, 0.0), point=(0.0, -1.0, 0.0)),
        build.light("lamp", location=(1.0, 2.0, 3.0), emissivity=(4.0, 5.0, 6.0)),
        model="physical",
    )
    lost = export_scene(scene, tmp_path / "a.xml", "mitsuba", RenderSettings(model="physical", size=(64, 64)))
    assert not any("light through glass" in one for one in export_scene(scene, tmp_path / "a.pov", "pov"))
    for words in ("overlapping glass", "floor: a plane", "eye: its pixels are no squares", "light through glass"):
        assert any(one.startswith(words) for one in lost), (words, lost)


def by_pov_ray(scene, folder, settings):
    """POV-Ray's picture of a scene, with one ray at each pixel's centre."""
    lost = export_scene(scene, folder / "scene.pov", "pov", settings)
    width, height = settings.size
    command = f"povray +Iscene.pov +Oscene.ppm +W{width} +H{height} +FP16 File_Gamma=1.0 -A -D -GA"
    subprocess.run(command.split(), cwd=folder, check=True, capture_output=True)
    data = (folder / "scene.ppm").read_bytes()[-6 * width * height :]
    return lost, np.frombuffer(data, ">u2").reshape(height, width, 3).transpose(2, 0, 1) / 65535


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed")
@pytest.mark.parametrize("name", ["pov_ball", "two_balls", "glass_on_board", "lit"])
def test_pov_ray_renders_the_same_picture(name, tmp_path):
    if name == "lit":
        scene = board(**PICTURE)
        scene = build.make_scene(
            build.camera("eye", **CAMERA, center=(35.0, 20.0)),
            build.light("lamp", location=(1.0, 2.0, 3.0), emissivity=(9.0, 8.0, 7.0)),
            build.texture("lines", **CHECKS),
            build.material("matt", diffuse=(0.9, 0.8, 0.7), texture="lines"),
            build.material("red", diffuse=(0.8, 0.1, 0.1)),
            build.plane("floor", material="matt", normal=(0.0, 1.0, 0.2), point=(0.0, -1.0, 0.0)),
            build.sphere("ball", material="red", center=(0.0, 0.0, 0.0), radius=0.7),
            model="physical",
            dtype=np.float64,
        )
    else:
        scene = load_scene(name, dtype=np.float64)
    if name == "glass_on_board":
        scene = set_parameters(scene, {"tinted.absorption": (0.0, 0.0, 0.0)})
    settings = RenderSettings(model="physical", size=(160, 120))
    lost, picture = by_pov_ray(scene, tmp_path, settings)
    assert not lost
    off = np.abs(picture - np.clip(render(scene, settings).image, 0, 1)).max(axis=0)
    assert np.mean(off > 2e-5) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two_balls", "bubble", "board", "checks", "aside", "slab", "walls", "oil"])
def test_mitsuba_renders_the_same_picture(name, tmp_path):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    boards = {"board": PICTURE, "checks": CHECKS, "aside": PICTURE}
    scene = pane(name) if name in SURFACES else board(**boards[name]) if name in boards else load_scene(name)
    if name == "aside":
        scene = build.make_scene(
            build.camera("eye", **CAMERA, center=(40.0, 12.0)),
            build.texture("lines", **PICTURE),
            build.material("board", emission=(1.0, 1.0, 1.0), texture="lines"),
            build.rectangle(
                "back", material="board", center=(0.0, 0.0, -1.0), right=(2.7, 0.3, 0.0), up=(-0.3, 2.7, 0.0)
            ),
            model="physical",
        )
    settings = RenderSettings(model="physical", size=SIZE, samples=8)
    export_scene(scene, tmp_path / "scene.xml", "mitsuba", settings)
    loaded = mi.load_file(str(tmp_path / "scene.xml"))
    # Paths through panes have more noise.
    picture = np.array(mi.render(loaded, spp=768 if name in SURFACES else 256, seed=1)).transpose(2, 0, 1)
    ours = np.asarray(render(scene, settings).image)
    # In squares of 8 x 8 pixels, over which the noise of both averages out.
    means = [image.reshape(3, 6, 8, 8, 8).mean((2, 4)) for image in (picture, ours)]
    np.testing.assert_allclose(*means, atol=0.01)
    # What tinted media leave is dark, and its noise is not less by as much.
    np.testing.assert_allclose(picture.mean(), ours.mean(), rtol=3e-3, atol=2e-4)


def test_exported_pictures_are_whole(tmp_path):
    export_scene(board(**PICTURE), tmp_path / "a.pov", "pov")
    found = {path.name for path in tmp_path.iterdir()}
    assert found == {"a.pov", "a.above.exr", "a.board.exr"}
    stored = read_exr(tmp_path / "a.board.exr").channels
    np.testing.assert_array_equal(np.stack([stored[c] for c in "RGB"]), PICTURE["file"])
    with pytest.raises(SceneError, match="a whole picture is exported"):
        export_scene(board(**PICTURE), tmp_path / "a.pov", "pov", RenderSettings(crop=(0, 0, 4, 4)))
    with pytest.raises(SceneError, match="there is no format 'obj'"):
        export_scene(board(**PICTURE), tmp_path / "a.obj", "obj")


def test_without_mitsuba_it_says_the_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    (tmp_path / "a.xml").touch()
    assert run("import", str(tmp_path / "a.xml"), "-o", str(tmp_path / "a.txt")) == 1
    assert "pip install 'mitsuba>=" in capsys.readouterr().err


def test_light_inside_glass_is_named(tmp_path):
    def lost(*shapes, eye=(0.4, 0.3, 4.0)):
        made = build.make_scene(
            build.camera("eye", **{**CAMERA, "viewpoint": eye}),
            build.material("clear", transmission=1.0),
            build.material("lit", emission=(1.0, 1.0, 1.0)),
            *shapes,
            model="physical",
        )
        found = export_scene(made, tmp_path / "a.xml", "mitsuba")
        return any(one.startswith("light from within glass") for one in found)

    ball = build.sphere("ball", material="clear", center=(0.0, 0.0, 0.0), radius=1.0)
    bulb = build.sphere("bulb", material="lit", center=(0.1, 0.0, 0.0), radius=0.2)
    sky = build.background("sky", radiance=(1.0, 1.0, 1.0))
    assert lost(ball, bulb) and lost(ball, sky, eye=(0.0, 0.1, 0.0))
    sea = build.plane("sea", material="clear", normal=(0.0, 1.0, 0.0), point=(0.0, 0.0, 0.0))
    # Half of the sky is below the surface.
    assert lost(sea, sky) and lost(sea, bulb)
    assert not lost(ball) and not lost(bulb) and not lost(sea)
    # A board whose lower edge alone is below it.
    assert lost(sea, build.rectangle("b", material="lit", center=(0, 2.2, 0), right=(1, 0, 0), up=(0, 2.3, 0)))
    assert not lost(sea, build.rectangle("b", material="lit", center=(0, 2.2, 0), right=(1, 0, 0), up=(0, 2.1, 0)))
    # Eye and lamp in one medium: no path comes out scaled.
    sunken = build.sphere("bulb", material="lit", center=(0.1, -0.5, 0.0), radius=0.2)
    assert not lost(sea, sunken, eye=(0.4, -0.3, 4.0)) and lost(sea, bulb, eye=(0.4, -0.3, 4.0))
