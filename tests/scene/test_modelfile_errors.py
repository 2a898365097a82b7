"""Errors of the `model.txt` reader: they say where, what came and what is valid, and they come fast."""

import os
import time

import numpy as np
import pytest

from raytrace_jax import ModelFileError, load_scene, parse_scene

CAMERA = "camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 }"
SPHERE = CAMERA + "\nmaterial red { }\nsphere ball { material red center 0 0 0 radius 1 }"
EYE = "camera eye { pixeldim 4 3 viewpoint 0 0 5 lookat 0 0 0 up 0 1 0 fov 40 }"
BOARD = CAMERA + "\nmaterial red { }\nrectangle board { material red center 0 0 0 right 2 0 0 up 0 1 0 }"
PLANE = CAMERA + "\nmaterial red { }\nplane wall { material red normal 0 0 1 point 0 0 0 }"


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("", "1:1", ["no camera"]),
        ("\ufeffcamra", "1:1", ["'camera'?"]),
        (" \n\t\r\n", "3:1", ["no camera"]),
        ("light a { location 0 0 0 emissivity 1 1 1 }", "1:44", ["no camera"]),
        (CAMERA + "\n" + CAMERA, "2:8", ["second camera", "'eye' comes before it"]),
        (SPHERE.replace("sphere", "spere"), "3:1", ["'spere'", "'sphere'", "texture, material, plane, sphere"]),
        (SPHERE.replace("radius", "radus"), "3:41", ["'radus'", "'radius'", "material, center, radius"]),
        (SPHERE.replace("{ }", "{ colour 1 1 1 }"), "2:16", ["'colour'", "ambient, diffuse, specular, alpha, ior"]),
        (SPHERE.replace("0 0 0", "0 0"), "3:39", ["3 numbers (x y z)", "after 2 of them 'radius' is not"]),
        (SPHERE.replace("radius 1", "radius"), "3:48", ["radius takes 1 number", "'}' is not a number"]),
        (SPHERE.replace("0 0 0", "0 0 0 7"), "3:41", ["too many", "center takes 3 numbers", "'7'"]),
        (SPHERE.replace("material red c", "material red 5 c"), "3:28", ["too many", "name of a material"]),
        (SPHERE.replace("0 0 0", "0 zero 0"), "3:37", ["'zero' is not a number"]),
        (SPHERE.replace("0 0 0", "0,0,0"), "3:35", ["'0,0,0' is not a number", "commas"]),
        (SPHERE.replace("radius 1", "radius 1_0"), "3:48", ["'1_0' is not a number"]),
        (SPHERE.replace("radius 1", "radius ٣"), "3:48", ["not a number"]),
        (SPHERE.replace("0 0 0", "0 0 1e39"), "3:35", ["center must be finite in float32", "1e+39"]),
        (SPHERE.replace("radius 1", "radius 0"), "3:48", ["sphere 'ball'", "radius must be greater than 0", "'0.0'"]),
        (SPHERE.replace("radius 1", "radius 1e-60"), "3:48", ["'1e-60'", "is 0.0 in float32"]),
        (SPHERE.replace("{ }", "{ ior 1.5 1.6 }"), "2:28", ["1 number or ior takes 3 numbers", "after 2 of them '}'"]),
        (SPHERE.replace("{ }", "{ ior 1.5 ior 1.6 }"), "2:24", ["material 'red' has ior twice"]),
        (SPHERE.replace("material red c", "material rad c"), "3:24", ["material 'rad'", "'red'?", "scene: red"]),
        (SPHERE.replace("material red { }", ""), "3:24", ["unknown material 'red'", "none"]),
        (SPHERE.replace("material red c", "material } c"), "3:24", ["name of a material", "'}'"]),
        (SPHERE.replace("material red c", "c"), "3:8", ["sphere 'ball' lacks material", "material, center, radius"]),
        (PLANE.replace("normal 0 0 1", "normal 0 -0 0"), "3:34", ["other than 0 0 0", "'(0.0, -0.0, 0.0)'"]),
        (CAMERA.replace("4 3 w", "4.5 3 w"), "1:23", ["'4.5' is not a whole number"]),
        (CAMERA.replace("4 3 w", "0 3 w"), "1:23", ["pixeldim must be from 1 to 32768", "'(0, 3)'"]),
        (CAMERA.replace("4 3 w", "4 " + "9" * 5000 + " w"), "1:25", ["too large"]),
        (EYE.replace("up 0 1 0", "up 0 0 -2"), "1:59", ["camera 'eye'", "up must not be parallel"]),
        (EYE.replace("lookat 0 0 0", "lookat 0 0 5"), "1:59", ["lookat must be another point than viewpoint"]),
        (EYE.replace("fov 40", "worlddim 8 6"), "1:65", ["mixes two kinds", "worlddim does not go with lookat, up"]),
        (
            EYE.replace("lookat 0 0 0 up 0 1 0 fov 40", ""),
            "1:8",
            ["lacks worlddim; or lookat", "pixeldim, worlddim, viewpoint; or pixeldim, viewpoint, lookat"],
        ),
        (BOARD.replace("up 0 1 0", "up .2 1 0"), "3:60", ["right and up must be orthogonal", "78.6901 degrees"]),
        (SPHERE + SPHERE[SPHERE.index("\nsphere") :], "4:8", ["'ball' is taken", "sphere 'ball' has it"]),
        (SPHERE + "\nmaterial red { }", "4:10", ["material name 'red' is taken"]),
        (SPHERE[:-1], "3:1", ["sphere 'ball' is never closed"]),
        (CAMERA[:-1] + SPHERE[len(CAMERA) :], "2:1", ["'eye' has no attribute 'material'", "'}' missing?"]),
        (CAMERA + "}", "1:57", ["unknown keyword '}'"]),
        (CAMERA + " sphere", "1:64", ["expected a name", "end of the file"]),
        (CAMERA + " sphere { }", "1:65", ["expected a name", "'{'"]),
        (CAMERA + " sphere big ball { }", "1:69", ["expected '{'", "'ball'"]),
        (SPHERE.replace("radius 1", "radius 1//big"), "3:48", ["'1//big' is not a number", "begins after white space"]),
        (SPHERE.replace("ball", "#ball"), "3:52", ["expected a name", "end of the file"]),
        (CAMERA + "\nmaterial\0", "2:1", ["unknown keyword 'material\\x00'"]),
    ],
)
def test_errors_say_where_and_what(text, place, words):
    with pytest.raises(ModelFileError) as caught:
        parse_scene(text, source="my.txt", dtype=np.float32)
    message = str(caught.value)
    assert message.startswith(f"my.txt:{place}: ")
    for word in words:
        assert word in message
    assert len(message) < 500
    assert "\n" not in message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"camera eye {\n  \xff\xd8", ["cannot be read", "0xff in position 15", "utf-8"]),
        ("camera".encode("utf-16-le"), [":1:1: ", r"'c\x00a"]),
        (b"\x89PNG\r\n\x1a\n\0\0", ["cannot be read", "0x89 in position 0"]),
        (b"", [":1:1: ", "no camera"]),
    ],
)
def test_files_that_are_no_text(tmp_path, content, words):
    path = tmp_path / "scene.txt"
    path.write_bytes(content)
    with pytest.raises(ModelFileError) as caught:
        load_scene(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(ModelFileError, match="directory") as caught:
        load_scene(tmp_path)
    assert str(tmp_path) in str(caught.value)
    with pytest.raises(ModelFileError, match=r"nothing\.txt: there is no such file"):
        load_scene(str(tmp_path / "nothing.txt"))
    with pytest.raises(ModelFileError, match="cannot be read"):
        load_scene("a\0b")
    with pytest.raises(TypeError, match="floating"):
        parse_scene(CAMERA, dtype=np.int32)
    path = tmp_path / "scene.txt"
    path.write_text(CAMERA)
    os.truncate(path, 2**30)  # Zeros that no disk has to hold.
    with pytest.raises(ModelFileError, match="larger than 64 MiB"):
        load_scene(path)


@pytest.mark.parametrize(
    "text",
    [
        "1" * 10_000_000 + "x",
        "camera eye { viewpoint " + "1" * 10_000_000 + "x",
        "camera eye { viewpoint 1e" + "1" * 10_000_000,
        "camera eye { worlddim " + "." * 10_000_000,
        "camera eye { " + "a" * 10_000_000,
        "{" * 10_000_000,
        "\n" * 10_000_000 + "x",
    ],
    ids=["digits", "number", "exponent", "dots", "word", "braces", "lines"],
)
def test_ten_megabytes_of_garbage_fail_fast(text):
    start = time.perf_counter()
    with pytest.raises(ModelFileError) as caught:
        parse_scene(text)
    assert time.perf_counter() - start < 5.0  # quadratic time would be days
    assert len(str(caught.value)) < 500


def test_a_misspelled_texture_is_asked_for(tmp_path):
    (tmp_path / "wood.png").write_bytes(b"")
    text = CAMERA + " texture t { kind image file wod.png transfer srgb }"
    with pytest.raises(ModelFileError, match=r"there is no such file; did you mean wood\.png\?$"):
        parse_scene(text, folder=tmp_path)
