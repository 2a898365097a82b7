"""Scenes of Mitsuba: what was exported comes back number for number, and what is lost is named or refused."""

import re

import numpy as np
import pytest
from command_line import run
from exchange_scenes import CAMERA, CHECKS, PICTURE, board, pane

from raytrace_jax import (
    RenderSettings,
    Scene,
    SceneError,
    build,
    export_scene,
    import_scene,
    load_scene,
    render,
    write_exr,
)

pytest.importorskip("mitsuba")


def plain(scene, folder):
    """A scene as plain values by block, without its settings, the names of files, and how its camera is turned."""
    scene.save(folder / "plain.txt")
    rows = load_scene(folder / "plain.txt", dtype=np.float64, model="physical").to_dict()["blocks"]
    blocks = {(row["block"], row["name"]): row for row in rows if row["block"] != "settings"}
    for row in blocks.values():
        row.pop("file", None)
    for key in ("lookat", "up"):
        blocks["camera", scene.camera.name].pop(key, None)
    return blocks


def round_trip(scene, folder):
    lost = export_scene(scene, folder / "scene.xml", "mitsuba")
    again, not_read = import_scene(folder / "scene.xml", dtype=np.float64)
    assert not not_read
    # Mitsuba keeps a camera as a matrix, not the point that it looks at.
    np.testing.assert_allclose(turned(again.camera), turned(scene.camera), rtol=0, atol=1e-15)
    return lost, again


def turned(camera):
    """To the right of a camera, and ahead of it."""
    ahead = np.subtract(camera.lookat, camera.viewpoint)
    right = np.cross(ahead, camera.up)
    return [right / np.linalg.norm(right), ahead / np.linalg.norm(ahead)]


@pytest.mark.parametrize("name", ["pov_ball", "two_balls", "bubble"])
def test_bundled_scenes_come_back_exactly(name, tmp_path):
    scene = load_scene(name, dtype=np.float64)
    lost, again = round_trip(scene, tmp_path)
    assert not lost and plain(again, tmp_path) == plain(scene, tmp_path)
    for one, other in zip(scene.images.texels, again.images.texels, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("texture", [CHECKS, PICTURE])
def test_a_scene_of_everything_comes_back(texture, tmp_path):
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


def test_center_and_lights_come_back(tmp_path):
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


@pytest.mark.parametrize("kind", ["slab", "walls", "planes", "oil"])
def test_flat_glass_comes_back(kind, tmp_path):
    scene, settings = pane(kind), RenderSettings(size=(16, 12))
    export_scene(scene, tmp_path / "scene.xml", "mitsuba")
    again, not_read = import_scene(tmp_path / "scene.xml", dtype=np.float64)
    assert not not_read
    np.testing.assert_allclose(render(again, settings).image, render(scene, settings).image, rtol=0, atol=1e-9)
    # Materials that shapes share stay one. Of oil Mitsuba has a medium without a name: it is the sea's other side.
    names = {
        "slab": {"air_behind", "glass"},
        "walls": {"air_behind", "window_wall", "glass"},
        "planes": {"glass"},
        "oil": {"water", "sea_outside_material"},
    }
    assert set(again.materials.names) == {"board", "air", *names[kind]}


def test_an_eye_in_tinted_glass_comes_back(tmp_path):
    scene = build.make_scene(
        build.camera("eye", **CAMERA),
        build.background("sky", radiance=(1.0, 1.0, 1.0)),
        build.material("tinted", transmission=1.0, ior=1.3, absorption=(0.1, 0.2, 0.3)),
        build.material("air", transmission=1.0),
        build.sphere("tank", material="tinted", center=(0.0, 0.0, 4.0), radius=3.0),
        build.sphere("bubble", material="air", center=(0.0, 0.0, 2.0), radius=0.5),
        model="physical",
        dtype=np.float64,
    )
    lost, again = round_trip(scene, tmp_path)
    assert [one.split(":")[0] for one in lost] == ["light from within glass, or seen from within"]
    assert plain(again, tmp_path) == plain(scene, tmp_path)
    medium = '<medium name="{}" type="homogeneous"><float name="albedo" value="0"/></medium>'
    text = (tmp_path / "scene.xml").read_text().replace("0.1, 0.2, 0.3", "0.5, 0.2, 0.3", 1)
    (tmp_path / "other.xml").write_text(text)
    assert "sensor: medium" in import_scene(tmp_path / "other.xml")[1][-1]
    # A ball in a medium that has no end cannot be said.
    (tmp_path / "ball.xml").write_text(whole(glass_ball(1, 1.5, 1.3, medium.format("exterior"))))
    assert import_scene(tmp_path / "ball.xml")[1][-1].startswith("shape b1: exterior")


@pytest.mark.parametrize(("half", "far"), [(2.0, 1.0), (100.0, 9.0)])
def test_glass_that_ends_is_no_plane(half, far, tmp_path):
    """A pane close to the eye, whose ends show where something stands far behind it."""
    pane = f'<transform name="to_world"><scale value="{half}"/><translate z="0.01"/></transform>'
    ball = f'<shape type="sphere"><point name="center" x="0" y="0" z="{far}"/></shape>'
    text = whole(f'<shape type="rectangle" id="pane">{pane}<bsdf type="dielectric"/></shape>{ball}')
    (tmp_path / "a.xml").write_text(text)
    scene, lost = import_scene(tmp_path / "a.xml")
    assert any(one.startswith("shape pane: flat glass that ends") for one in lost) and not scene.planes.names


def test_names_that_kinds_share_come_back(tmp_path):
    scene = build.make_scene(
        build.camera("ball", **CAMERA),
        build.texture("wall", **CHECKS),
        build.material("wall", emission=(1.0, 1.0, 1.0), texture="wall"),
        build.material("glow", emission=(0.5, 0.5, 0.5), texture="wall"),
        build.material("ball", transmission=1.0, ior=1.5),
        build.rectangle("wall", material="wall", center=(0.0, 0.0, -2.0), right=(2.0, 0.0, 0.0), up=(0.0, 2.0, 0.0)),
        build.rectangle("glow", material="glow", center=(0.0, -2.0, 0.0), right=(3.0, 0.0, 0.0), up=(0.0, 0.0, -2.0)),
        build.sphere("ball", material="ball", center=(0.0, 0.0, 0.0), radius=1.0),
        build.sphere("ball2", material="ball", center=(2.0, 0.0, 0.0), radius=0.4),
        model="physical",
        dtype=np.float64,
    )
    _, again = round_trip(scene, tmp_path)
    assert again.shape_order == scene.shape_order and again.materials.names == scene.materials.names
    assert again.checkers.names == ("wall", "wall2") and again.camera.name == "ball"


SENSOR = '<scene version="3.0.0"><sensor type="perspective" id="eye">{}</sensor></scene>'
VIEW = """<scene version="3.0.0"><sensor type="perspective">{}
<transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm">{}<integer name="width" value="16"/><integer name="height" value="12"/></film></sensor>
<shape type="sphere"/>{}</scene>"""
WEIGHT = '<emitter type="{}"><float name="sampling_weight" value="{}"/></emitter>'
HEAD = '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>'
MIRROR = '<transform name="to_world"><scale x="-1"/></transform>'
GLASS = '<shape type="sphere"><bsdf type="dielectric">{}</bsdf></shape>'
SKY = '<emitter type="constant"><spectrum {} name="radiance"/></emitter>'


def whole(text):
    """A file, of which the head with its camera and the end may be left out."""
    return text if text.startswith("<scene") else f"{HEAD}{text}</scene>"


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
    <rgb name="color0" value="1 0 0"/> <float name="color1" value=".25"/>
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


def test_a_handwritten_scene_is_read(tmp_path):
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
        ('<integrator type="path"><boolean name="hide_emitters" value="true"/></integrator>', "hide_emitters"),
        ('<shape type="sphere" id="a"><medium name="exterior" type="homogeneous"/></shape>', "shape a: exterior"),
        (
            '<shape type="rectangle" id="flag"><bsdf type="twosided"><bsdf type="diffuse"/><bsdf type="diffuse"/>'
            "</bsdf></shape>",
            "shape flag: the second bsdf, of its back",
        ),
        ('<shape type="rectangle" id="pane"><bsdf type="dielectric"/></shape>', "shape pane: flat glass"),
        ('<shape type="sphere" id="a"/><emitter type="constant"/>', "a is matt and lit by point lights alone"),
        (
            '<shape type="sphere" id="a"><bsdf type="diffuse"><texture name="reflectance" type="checkerboard"/></bsdf>'
            "</shape>",
            "shape a: a texture on a sphere; it has the mean colour",
        ),
        (VIEW.format('<float name="near_clip" value="3.9"/>', "", ""), "sensor perspective: near_clip"),
        (VIEW.format("", "", WEIGHT.format("point", 0)), "emitter point: sampling_weight"),
        (GLASS.format('<float name="intIOR" value="2"/>'), "bsdf dielectric: intIOR"),
        (VIEW.format("", '<string name="pixel_format" value="luminance"/>', ""), "film pixel_format luminance"),
        (f'<shape type="sphere">{MIRROR}</shape>', "shape sphere: a mirror in to_world"),
    ],
)
def test_what_is_otherwise_there_is_named(text, words, tmp_path):
    (tmp_path / "a.xml").write_text(whole(text))
    scene, lost = import_scene(tmp_path / "a.xml")
    assert any(one.startswith(words) or words in one for one in lost), lost
    assert np.isfinite(render(scene, RenderSettings(size=(8, 6))).image).all()


def test_other_spellings_are_read(tmp_path):
    """A light by `lookat`, daylight, a material under any name, other files, the spellings of older versions."""
    (tmp_path / "textures").mkdir()
    write_exr(tmp_path / "textures" / "board.exr", np.full((3, 2, 2), 0.5, np.float32))
    board = '<texture name="radiance" type="bitmap"><string name="filename" value="board.exr"/></texture>'
    (tmp_path / "textures" / "b.xml").write_text(
        """<scene version="0.6.0"><shape type="sphere" id="old"><bsdf type="dielectric">
        <float name="intIOR" value="1.7"/><float name="extIOR" value="1"/></bsdf></shape></scene>"""
    )
    (tmp_path / "a.xml").write_text(
        f"""{HEAD}<path value="textures"/> <include filename="b.xml"/>
        <emitter type="point" id="torch"><transform name="to_world">
            <lookat origin="3,2,1" target="0,0,0" up="0,1,0"/></transform></emitter>
        <emitter type="constant" id="sky"><spectrum type="d65" name="radiance"/></emitter>
        <bsdf type="dielectric" id="clear"><float name="int_ior" value="1.6"/><float name="ext_ior" value="1"/></bsdf>
        <shape type="sphere" id="ball"><point name="center" x="9" y="0" z="0"/><ref name="material" id="clear"/></shape>
        <shape type="rectangle" id="wall"><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
            <emitter type="area">{board}</emitter></shape>
        </scene>"""
    )
    scene, lost = import_scene(tmp_path / "a.xml", dtype=np.float64)
    np.testing.assert_allclose(scene["torch.location"], [3, 2, 1])
    np.testing.assert_array_equal(scene["sky.radiance"], [1, 1, 1])
    assert scene["ball.ior"] == 1.6 and scene["old.ior"] == 1.7
    assert [one.split(":")[0] for one in lost] == ["rfilter gaussian"]


def glass_ball(size, inside, outside, more=""):
    indices = f'<float name="int_ior" value="{inside}"/><float name="ext_ior" value="{outside}"/>'
    body = f'<float name="radius" value="{size}"/><bsdf type="dielectric">{indices}</bsdf>'
    return f'<shape type="sphere" id="b{size}">{body}{more}</shape>'


@pytest.mark.parametrize("how", ["indices", "flip_normals", "a mirror", "flipNormals of version 0.6"])
def test_a_hollow_ball_is_recognised(how, tmp_path):
    is_old = how.endswith("0.6")
    flips = {
        "indices": "",
        "a mirror": MIRROR,
        "flip_normals": '<boolean name="flip_normals" value="true"/>',
        "flipNormals of version 0.6": '<boolean name="flipNormals" value="true"/>',
    }
    medium = '<medium type="homogeneous" name="{}"><float name="albedo" value="0"/></medium>'
    around = medium.format("exterior" if how == "indices" else "interior")
    inner = glass_ball(1, *((1, 1.5) if how == "indices" else (1.5, 1)), flips[how] + around)
    text = f"{HEAD}{glass_ball(2, 1.5, 1, medium.format('interior'))}{inner}</scene>"
    if is_old:
        text = text.replace("3.0.0", "0.6.0").replace("int_ior", "intIOR").replace("ext_ior", "extIOR")
    (tmp_path / "a.xml").write_text(text)
    scene, lost = import_scene(tmp_path / "a.xml", dtype=np.float64)
    assert scene["b1.ior"] == 1 and scene["b2.ior"] == 1.5
    assert not np.any(scene["b1_material.absorption"]) and np.all(scene["b2_material.absorption"] == 1)
    assert [one.split(":")[0] for one in lost] == ["rfilter gaussian"]


def test_nested_indices_count_from_vacuum(tmp_path):
    balls = glass_ball(1, 1.3, 1.5) + glass_ball(3, 1.6, 1.000277) + glass_ball(2, 1.5, 1.6)
    (tmp_path / "a.xml").write_text(f"{HEAD}{balls}</scene>")
    scene, _ = import_scene(tmp_path / "a.xml", dtype=np.float64)
    for size, ior in ((3, 1.6 / 1.000277), (2, 1.5 / 1.000277), (1, 1.3 / 1.000277)):
        np.testing.assert_allclose(scene[f"b{size}.ior"], ior, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<scene", "a.xml"),
        ('<scene version="3.0.0"/>', "no perspective sensor"),
        ('\n<shape type="sphere"><ref id="nothing"/></shape>', "a.xml (line 2, col 2): unresolved ref"),
        ('<shape type="sphere"><float name="radius" value="-1"/></shape>', "radius"),
        ('<emitter type="envmap"/>', "has no filename"),
        ('<emitter type="envmap"><string name="filename" value="no.exr"/></emitter>', "no such file"),
        (GLASS.format('<string name="int_ior" value="jelly"/>'), "the index 'jelly'"),
        (SENSOR.format('<string name="focal_length" value="wide"/>'), "sensor eye: focal_length is 'wide'"),
        (SENSOR.format('<string name="fov_axis" value="vertical"/><float name="fov" value="4"/>'), "'vertical'"),
        (SENSOR.format('<string name="fov" value="4"/>'), "fov is '4', and a number is wanted"),
        (SKY.format('type="blackbody"'), "radiance is a spectrum of type blackbody"),
        (SKY.format('value="400:1 700:2"'), "radiance is a spectrum by wavelengths"),
    ],
)
def test_an_unreadable_file_is_refused(text, words, tmp_path, capsys):
    (tmp_path / "a.xml").write_text(whole(text))
    with pytest.raises(SceneError, match=re.escape(words)):
        import_scene(tmp_path / "a.xml")
    assert run("import", str(tmp_path / "a.xml"), "-o", str(tmp_path / "a.txt")) == 1
    error = capsys.readouterr().err
    assert words in error and "Traceback" not in error and not (tmp_path / "a.txt").exists()


def test_the_commands_say_what_is_lost(tmp_path, capsys):
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


def test_nested_references_are_read_fast(tmp_path):
    steps = "".join(
        f'<bsdf type="twosided" id="b{k}"><ref name="one" id="b{k + 1}"/><ref name="two" id="b{k + 1}"/></bsdf>'
        for k in range(60)
    )
    last = '<bsdf type="diffuse" id="b60"/><shape type="sphere"><ref id="b0"/></shape>'
    (tmp_path / "a.xml").write_text(f"{HEAD}{steps}{last}</scene>")
    scene, _ = import_scene(tmp_path / "a.xml")
    assert len(scene.spheres.names) == 1
