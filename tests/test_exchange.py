"""Scenes for other renderers and from them: nothing changes on the way there and back, and what is lost is named."""

import re
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from command_line import run

from raytrace_jax import (
    RenderSettings,
    Scene,
    SceneError,
    build,
    export_scene,
    import_scene,
    load_scene,
    read_exr,
    render,
    set_parameters,
    write_exr,
)

SIZE = (64, 48)
CAMERA = {"pixeldim": SIZE, "viewpoint": (0.4, 0.3, 4.0), "lookat": (0.1, 0.0, 0.0), "fov": 41.0}


def plain(scene, folder):
    """A scene as plain values by block, without its settings and the names of files."""
    scene.save(folder / "plain.txt")
    rows = load_scene(folder / "plain.txt", dtype=np.float64, model="physical").to_dict()["blocks"]
    blocks = {(row["block"], row["name"]): row for row in rows if row["block"] != "settings"}
    for row in blocks.values():
        row.pop("file", None)
    return blocks


def round_trip(scene, folder):
    lost = export_scene(scene, folder / "scene.xml", "mitsuba")
    again, not_read = import_scene(folder / "scene.xml", dtype=np.float64)
    assert not not_read
    return lost, again


def board(**texture):
    """A glass ball in which a smaller one lies, before a board and beside a matt ball, all of it lit."""
    sky = np.linspace(0.1, 1.3, 3 * 4 * 8).reshape(3, 4, 8).astype(np.float16)
    return build.make_scene(
        build.settings("main", model="physical", max_bounces=6),
        build.camera("eye", **CAMERA),
        build.background("all", radiance=(0.7, 0.7, 0.7), texture="above"),
        build.texture("above", kind="image", file=sky, wrap="repeat"),
        build.texture("lines", **texture),
        build.material("board", emission=(1.0, 1.0, 1.0), texture="lines"),
        build.material("clear", transmission=1.0, ior=1.62, absorption=(0.1, 0.2, 0.3)),
        build.material("air", transmission=1.0, ior=1.1),
        build.material("steel", reflectivity=0.83),
        build.rectangle("back", material="board", center=(0.1, 0.2, -2.3), right=(2.7, 0.3, 0.0), up=(-0.3, 2.7, 0.0)),
        build.sphere("outer", material="clear", center=(0.2, 0.1, 0.3), radius=0.9),
        build.sphere("inner", material="air", center=(0.3, 0.1, 0.4), radius=0.31),
        build.sphere("mirror", material="steel", center=(-1.2, -0.3, -0.4), radius=0.45),
        build.sphere("other", material="steel", center=(1.4, -0.6, -0.6), radius=0.3),
        dtype=np.float64,
    )


CHECKS = {
    "kind": "checker",
    "color1": (0.1, 0.2, 0.3),
    "color2": (0.9, 0.7, 0.4),
    "square": 0.37,
    "offset": (0.1, 0.03),
}
PICTURE = {"kind": "image", "file": np.random.default_rng(3).uniform(size=(3, 6, 8)).astype(np.float16)}


@pytest.mark.parametrize("name", ["pov_ball", "two_balls", "bubble"])
def test_the_bundled_scenes_come_back_number_for_number(name, tmp_path):
    scene = load_scene(name, dtype=np.float64)
    lost, again = round_trip(scene, tmp_path)
    assert not lost and plain(again, tmp_path) == plain(scene, tmp_path)
    for one, other in zip(scene.images.texels, again.images.texels, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("texture", [CHECKS, PICTURE])
def test_a_scene_with_all_that_both_know_comes_back_number_for_number(texture, tmp_path):
    scene = board(**texture)
    lost, again = round_trip(scene, tmp_path)
    # The background's radiance is in its picture, as one of Mitsuba's.
    expected = plain(scene, tmp_path)
    expected["background", "all"]["radiance"] = [1.0, 1.0, 1.0]
    assert not lost and plain(again, tmp_path) == expected
    assert again.settings.max_bounces == 6
    sky = scene.images.texels[scene.images.names.index("above")] * 0.7
    np.testing.assert_allclose(again.images.texels[again.images.names.index("above")], sky, rtol=1e-7)
    if texture is PICTURE:
        np.testing.assert_array_equal(again.images.texels[again.images.names.index("lines")], PICTURE["file"])


def test_a_principal_point_and_lights_come_back(tmp_path):
    scene = build.make_scene(
        build.settings("main", model="physical"),
        build.camera("eye", **CAMERA, center=(30.25, 25.5)),
        build.light("lamp", location=(1.0, 2.0, 3.0), emissivity=(4.0, 5.0, 6.0)),
        build.material("matt", diffuse=(0.2, 0.4, 0.6)),
        build.rectangle("wall", material="matt", center=(0.0, 0.0, -1.0), right=(0.0, 2.0, 0.0), up=(2.0, 0.0, 0.0)),
        dtype=np.float64,
    )
    lost, again = round_trip(scene, tmp_path)
    assert not lost
    np.testing.assert_allclose(again.camera.center, scene.camera.center, rtol=1e-12)
    expected, found = plain(scene, tmp_path), plain(again, tmp_path)
    for blocks in (expected, found):
        blocks["camera", "eye"].pop("center")
    assert found == expected


def test_the_program_in_python_has_the_same_scene(tmp_path, monkeypatch):
    export_scene(board(**CHECKS), tmp_path / "scene.py", "mitsuba-dict")

    class Transform:
        def __init__(self, matrix=None):
            self.matrix = matrix

        def look_at(self, **how):
            return how

    fake = types.SimpleNamespace(variant=lambda: "fake", ScalarTransform4f=Transform)
    monkeypatch.setitem(sys.modules, "mitsuba", fake)
    names = {"__name__": "scene", "__file__": str(tmp_path / "scene.py")}
    exec(compile((tmp_path / "scene.py").read_text(), "scene.py", "exec"), names)
    scene = names["SCENE"]
    assert scene["outer"]["bsdf"] == {"type": "dielectric", "int_ior": 1.62, "ext_ior": 1.0}
    assert scene["inner"]["bsdf"]["ext_ior"] == 1.62 and scene["inner"]["exterior"]["type"] == "homogeneous"
    assert scene["steel"]["type"] == "conductor" and scene["mirror"]["bsdf"] == {"type": "ref", "id": "steel"}
    assert scene["eye"]["to_world"]["origin"] == list(CAMERA["viewpoint"])
    assert Path(scene["all"]["filename"]).is_file()


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
def test_what_the_other_program_cannot_be_told_is_named(to, words, tmp_path):
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


def test_overlapping_glass_planes_and_pixels_that_are_no_squares_are_named(tmp_path):
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


SENSOR = '<scene version="3.0.0"><sensor type="perspective" id="eye">{}</sensor></scene>'
HEAD = '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>'
BY_HAND = """<?xml version="1.0"?>
<scene version="3.0.0">
  <default name="spp" value="16"/> <default name="size" value="0.5"/>
  <integrator type="path"><integer name="max_depth" value="9"/></integrator>
  <sensor type="perspective" id="my camera">
    <string name="fov_axis" value="smaller"/> <float name="fov" value="30"/>
    <transform name="to_world">
      <rotate y="1" angle="90"/> <translate value="5, 1, 0"/>
    </transform>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
    <film type="hdrfilm"><integer name="width" value="80"/><integer name="height" value="60"/></film>
  </sensor>
  <bsdf type="dielectric" id="glass"><string name="int_ior" value="water"/><float name="ext_ior" value="1"/></bsdf>
  <texture type="checkerboard" id="checks">
    <rgb name="color0" value="#ff0000"/> <float name="color1" value=".25"/>
  </texture>
  <shape type="sphere" id="ball">
    <transform name="to_world"><scale value="$size"/><translate x="1" y="2" z="3"/></transform>
    <ref id="glass"/>
  </shape>
  <shape type="sphere"><point name="center" x="9" y="0" z="0"/><ref id="glass"/></shape>
  <shape type="rectangle">
    <transform name="to_world"><scale x="2" y="2"/></transform>
    <bsdf type="twosided"><bsdf type="diffuse"><ref name="reflectance" id="checks"/></bsdf></bsdf>
  </shape>
  <shape type="sphere"><bsdf type="roughconductor"><string name="material" value="Au"/></bsdf></shape>
  <shape type="obj" id="bunny"><string name="filename" value="bunny.obj"/></shape>
  <emitter type="spot" id="torch"/>
  <emitter type="point"><point name="position" value="1 2 3"/><rgb name="intensity" value="2"/></emitter>
</scene>
"""


def test_a_scene_by_hand_is_read_and_what_is_left_out_is_named(tmp_path):
    (tmp_path / "a.xml").write_text(BY_HAND)
    scene, lost = import_scene(tmp_path / "a.xml", dtype=np.float64)
    assert scene.camera.name == "my_camera" and scene.camera.pixeldim == (80, 60)
    np.testing.assert_allclose(scene.camera.lookat - scene.camera.viewpoint, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(np.tan(np.radians(scene.camera.fov / 2)), np.tan(np.radians(15)) * 80 / 60)
    assert scene.settings.max_bounces == 8
    assert scene["ball.ior"] == 1.333 and scene["ball.radius"] == 0.5
    np.testing.assert_array_equal(scene["ball.center"], [1, 2, 3])
    assert scene.spheres.material[0] == scene.spheres.material[1] and len(scene.spheres.names) == 3
    np.testing.assert_array_equal(scene["checks.color1"], [1, 0, 0])
    assert scene["checks.square"] == 2 and scene["checks.offset"].tolist() == [-2, -2]
    np.testing.assert_array_equal(scene["light.emissivity"], [2, 2, 2])
    expected = (
        "rfilter gaussian",
        "shape sphere: bsdf roughconductor",
        "shape sphere: a metal",
        "shape bunny",
        "emitter torch",
    )
    for words in expected:
        assert any(one.startswith(words) for one in lost), (words, lost)
    assert len(lost) == len(expected)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f'{HEAD}<integrator type="path"><boolean name="hide_emitters" value="true"/></integrator>', "hide_emitters"),
        (
            f'{HEAD}<shape type="sphere" id="a"><medium name="exterior" type="homogeneous"/></shape>',
            "shape a: exterior",
        ),
        (
            f'{HEAD}<shape type="rectangle" id="flag"><bsdf type="twosided"><bsdf type="diffuse"/>'
            '<bsdf type="diffuse"/></bsdf></shape>',
            "shape flag: the second bsdf, of its back",
        ),
        (f'{HEAD}<shape type="rectangle" id="pane"><bsdf type="dielectric"/></shape>', "shape pane: flat glass"),
        (f'{HEAD}<shape type="sphere" id="a"/><emitter type="constant"/>', "a is matt and lit by point lights alone"),
        (
            f'{HEAD}<shape type="sphere" id="a"><bsdf type="diffuse"><texture name="reflectance" type="checkerboard"/>'
            "</bsdf></shape>",
            "shape a: a texture on a sphere; it has the mean colour",
        ),
    ],
)
def test_what_is_otherwise_there_is_named(text, words, tmp_path):
    (tmp_path / "a.xml").write_text(f"{text}</scene>")
    scene, lost = import_scene(tmp_path / "a.xml")
    assert any(one.startswith(words) or words in one for one in lost), lost
    assert np.isfinite(render(scene, RenderSettings(size=(8, 6))).image).all()


def test_what_other_programs_say_in_other_ways_is_read(tmp_path):
    """A light and a shape by `lookat`, daylight, a material under any name, pictures in other folders."""
    (tmp_path / "textures").mkdir()
    write_exr(tmp_path / "textures" / "board.exr", np.full((3, 2, 2), 0.5, np.float32))
    board = '<texture name="radiance" type="bitmap"><string name="filename" value="board.exr"/></texture>'
    (tmp_path / "a.xml").write_text(
        f"""{HEAD}<path value="textures"/>
        <emitter type="point" id="torch"><transform name="to_world">
            <lookat origin="3,2,1" target="0,0,0" up="0,1,0"/></transform></emitter>
        <emitter type="constant" id="sky"><spectrum type="d65" name="radiance"/></emitter>
        <bsdf type="dielectric" id="clear"><float name="int_ior" value="1.6"/><float name="ext_ior" value="1"/></bsdf>
        <shape type="sphere" id="ball"><ref name="material" id="clear"/></shape>
        <shape type="rectangle" id="wall"><transform name="to_world">
            <lookat origin="0,0,-2" target="0,0,5" up="0,1,0"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
            <emitter type="area">{board}</emitter></shape>
        </scene>"""
    )
    scene, lost = import_scene(tmp_path / "a.xml", dtype=np.float64)
    np.testing.assert_allclose(scene["torch.location"], [3, 2, 1])
    np.testing.assert_array_equal(scene["sky.radiance"], [1, 1, 1])
    assert scene["ball.ior"] == 1.6
    # Mitsuba's x axis points to the left of where a shape looks.
    np.testing.assert_allclose(scene["wall.right"], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(scene["wall.center"], [0, 0, -2])
    assert [one.split(":")[0] for one in lost] == ["rfilter gaussian"]


def test_a_sky_that_is_turned_by_a_lookat_is_that_of_the_same_turn(tmp_path):
    write_exr(tmp_path / "sky.exr", np.random.default_rng(0).uniform(size=(3, 4, 8)).astype(np.float32))
    skies = []
    for step in ('<lookat origin="0,0,0" target="1,0,0" up="0,1,0"/>', '<rotate y="1" angle="90"/>', ""):
        body = f'<string name="filename" value="sky.exr"/><transform name="to_world">{step}</transform>'
        (tmp_path / "a.xml").write_text(f'{HEAD}<emitter type="envmap">{body}</emitter></scene>')
        skies.append(import_scene(tmp_path / "a.xml")[0].images.texels[0])
    np.testing.assert_array_equal(skies[0], skies[1])
    assert not np.array_equal(skies[0], skies[2])


def test_nested_indices_count_from_vacuum(tmp_path):
    def ball(size, inside, outside):
        body = f'<float name="int_ior" value="{inside}"/><float name="ext_ior" value="{outside}"/>'
        radius, glass = f'<float name="radius" value="{size}"/>', f'<bsdf type="dielectric">{body}</bsdf>'
        return f'<shape type="sphere" id="b{size}">{radius}{glass}</shape>'

    balls = ball(1, 1.3, 1.5) + ball(3, 1.6, 1.000277) + ball(2, 1.5, 1.6)
    (tmp_path / "a.xml").write_text(f"{HEAD}{balls}</scene>")
    scene, _ = import_scene(tmp_path / "a.xml", dtype=np.float64)
    for size, ior in ((3, 1.6 / 1.000277), (2, 1.5 / 1.000277), (1, 1.3 / 1.000277)):
        np.testing.assert_allclose(scene[f"b{size}.ior"], ior, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<scene", "is no XML"),
        ("<svg/>", "its first element is svg"),
        ('<scene version="0.6.0"/>', "version 0.6.0"),
        ('<scene version="3.0.0"/>', "no perspective sensor"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><scene version="3.0.0">&b;</scene>', "document type or entities"),
        ('<scene version="3.0.0"><include filename="/etc/passwd"/></scene>', "other files are not read"),
        (f'{HEAD}<shape type="sphere"><ref id="nothing"/></shape></scene>', "ref nothing: there is no such plugin"),
        (
            f'{HEAD}<shape type="sphere"><float name="radius" value="wide"/></shape></scene>',
            "float radius: value is 'wide'",
        ),
        (
            f'{HEAD}<shape type="sphere"><float name="radius" value="$r"/></shape></scene>',
            "for which the file has no default",
        ),
        (f'{HEAD}<shape type="sphere"><float name="radius" value="-1"/></shape></scene>', "radius"),
        (f'{HEAD}<shape><float name="radius" value="1"/></shape></scene>', "has no type"),
        (f'{HEAD}<shape type="sphere"><rgb name="a" value="1 2"/></shape></scene>', "3 are wanted"),
        (f'{HEAD}<shape type="sphere"><nonsense name="a"/></shape></scene>', "nonsense a: there is no such element"),
        (f'{HEAD}<emitter type="envmap"/></scene>', "has no filename"),
        (f'{HEAD}<emitter type="envmap"><string name="filename" value="no.exr"/></emitter></scene>', "no such file"),
        (
            f'{HEAD}<shape type="sphere"><bsdf type="dielectric"><string name="int_ior" value="jelly"/></bsdf></shape>'
            "</scene>",
            "the index 'jelly'",
        ),
        (
            f'{HEAD}<shape type="sphere"><bsdf type="dielectric"><float name="intIOR" value="2"/></bsdf></shape>'
            "</scene>",
            "bsdf dielectric: it has no intIOR. Did you mean 'int_ior'?",
        ),
        (f'{HEAD}<shape type="sphere"><transform name="toWorld"/></shape></scene>', "Did you mean 'to_world'?"),
        (SENSOR.format('<string name="focal_length" value="wide"/>'), "sensor eye: focal_length is 'wide'"),
        (SENSOR.format('<string name="fov_axis" value="vertical"/><float name="fov" value="4"/>'), "'vertical'"),
        (SENSOR.format('<string name="fov" value="4"/>'), "fov is '4', and a number is wanted"),
        (
            f'{HEAD}<emitter type="point"><transform name="to_world"><lookat origin="0,2,0" target="0,0,0" up="0,1,0"/>'
            "</transform></emitter></scene>",
            "its target is its origin, or lies along its up",
        ),
        (
            f'{HEAD}<emitter type="constant"><spectrum type="blackbody" name="radiance"/></emitter></scene>',
            "a spectrum of type blackbody",
        ),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_in_words(text, words, tmp_path, capsys):
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(SceneError, match=re.escape(words)):
        import_scene(tmp_path / "a.xml")
    assert run("import", str(tmp_path / "a.xml"), "-o", str(tmp_path / "a.txt")) == 1
    error = capsys.readouterr().err
    assert words in error and "Traceback" not in error and not (tmp_path / "a.txt").exists()


def test_the_commands_say_what_is_lost_and_print_the_path(tmp_path, capsys):
    assert run("export", "glass_on_board", "--to", "mitsuba", "-o", str(tmp_path / "b" / "a.xml")) == 0
    captured = capsys.readouterr()
    assert captured.out.strip() == str(tmp_path / "b" / "a.xml")
    assert "1 thing" in captured.err and "floor: a plane" in captured.err
    assert run("import", str(tmp_path / "b" / "a.xml"), "-o", str(tmp_path / "c" / "a.txt"), "--quiet") == 0
    assert capsys.readouterr().err == ""
    assert {path.name for path in (tmp_path / "c").iterdir()} == {"a.txt", "a.evening.exr"}
    assert isinstance(load_scene(tmp_path / "c" / "a.txt"), Scene)
    assert run("export", "vitreous", "--to", "pov", "-o", str(tmp_path / "d")) == 1
    assert "the scene's model is classic" in capsys.readouterr().err
    assert run("export", "pov_ball", "--to", "blender", "-o", str(tmp_path / "d")) == 2
    assert "blender" in capsys.readouterr().err


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
@pytest.mark.parametrize("to", ["mitsuba", "mitsuba-dict"])
@pytest.mark.parametrize("name", ["two_balls", "bubble", "board", "aside"])
def test_mitsuba_renders_the_same_picture(name, to, tmp_path):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    scene = board(**(PICTURE if to == "mitsuba" else CHECKS)) if name in ("board", "aside") else load_scene(name)
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
    path = tmp_path / ("scene.xml" if to == "mitsuba" else "scene.py")
    export_scene(scene, path, to, settings)
    if to == "mitsuba":
        loaded = mi.load_file(str(path))
    else:
        names = {"__name__": "scene", "__file__": str(path)}
        exec(compile(path.read_text(), str(path), "exec"), names)
        loaded = mi.load_dict(names["SCENE"])
    picture = np.array(mi.render(loaded, spp=256, seed=1)).transpose(2, 0, 1)
    ours = np.asarray(render(scene, settings).image)
    # In squares of 8 x 8 pixels, over which the noise of both averages out.
    means = [image.reshape(3, 6, 8, 8, 8).mean((2, 4)) for image in (picture, ours)]
    np.testing.assert_allclose(*means, atol=0.01)
    assert abs(picture.mean() / ours.mean() - 1) < 3e-3


def test_exported_pictures_are_whole(tmp_path):
    export_scene(board(**PICTURE), tmp_path / "a.pov", "pov")
    found = {path.name for path in tmp_path.iterdir()}
    assert found == {"a.pov", "a.above.exr", "a.board.exr"}
    stored = read_exr(tmp_path / "a.board.exr").channels
    np.testing.assert_array_equal(np.stack([stored[c] for c in "RGB"]), PICTURE["file"])
    write_exr(tmp_path / "b.exr", np.ones((3, 2, 2)))
    with pytest.raises(SceneError, match="a whole picture is exported"):
        export_scene(board(**PICTURE), tmp_path / "a.pov", "pov", RenderSettings(crop=(0, 0, 4, 4)))
    with pytest.raises(SceneError, match="there is no format 'obj'"):
        export_scene(board(**PICTURE), tmp_path / "a.obj", "obj")


def test_light_that_begins_in_glass_is_named_for_mitsuba(tmp_path):
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
    assert lost(ball, bulb) and lost(ball, eye=(0.0, 0.1, 0.0))
    assert lost(build.plane("sea", material="clear", normal=(0.0, 1.0, 0.0), point=(0.0, 0.0, 0.0)))
    assert not lost(ball) and not lost(bulb)


def test_references_that_double_with_every_step_are_read_at_once(tmp_path):
    steps = "".join(
        f'<bsdf type="twosided" id="b{k}"><ref name="one" id="b{k + 1}"/><ref name="two" id="b{k + 1}"/></bsdf>'
        for k in range(60)
    )
    last = '<bsdf type="diffuse" id="b60"/><shape type="sphere"><ref id="b0"/></shape>'
    (tmp_path / "a.xml").write_text(f"{HEAD}{steps}{last}</scene>")
    scene, _ = import_scene(tmp_path / "a.xml")
    assert len(scene.spheres.names) == 1
