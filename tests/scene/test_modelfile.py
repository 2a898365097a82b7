"""The `model.txt` reader and writer: round trips to the bit, any spacing, canonical text."""

import dataclasses
from pathlib import Path

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from scenes import assert_same_scene

from raytrace_jax import ModelFileError, RaytraceWarning, Scene, format_scene, load_scene, parse_scene
from raytrace_jax.scene.schema import Attribute
from raytrace_jax.scene.structs import NOT_ALL_ZERO, NOT_NEGATIVE, POSITIVE, UNIT_INTERVAL
from raytrace_jax.scene.table import BLOCK_TYPES
from raytrace_jax.util.digits import format_number

DATA = Path(__file__).parents[2] / "data"
CAMERA = "camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 }"


def block_names():
    """Names that `is_name` accepts: `#` and `//` begin a comment, but not within a name."""
    invisible = ("Cc", "Cf", "Cs", "Zs", "Zl", "Zp")
    first = st.characters(exclude_categories=invisible, exclude_characters="{}#/")
    rest = st.text(st.characters(exclude_categories=invisible, exclude_characters="{}"), max_size=3)
    return st.builds(str.__add__, first, rest) | st.sampled_from(["/", "/a", "a#", "a//"])


def values_of(attribute, width):
    """All that a block may say of one attribute: all finite floats, -0.0 and subnormals among them."""
    # Without both limits hypothesis draws doubles, and throws away those that are too large for single precision.
    most = float(np.finfo(f"f{width // 8}").max)
    if attribute.value_type == "word":
        return st.sampled_from([*attribute.choices, *([None] if attribute.is_optional else [])])
    if attribute.value_type == "glass":
        return st.none()  # A scene has the indices, and a name in their place is tried elsewhere.
    if attribute.value_type == "integer":
        return st.integers(1, 64) | (st.none() if attribute.is_optional else st.nothing())
    if attribute.value_type == "constant":
        return st.none() | values_of(attribute._replace(value_type="number"), 64)
    intervals = {
        POSITIVE: st.floats(0, most, width=width, exclude_min=True) | st.just(1.0),
        NOT_NEGATIVE: st.floats(0, most, width=width),
        UNIT_INTERVAL: st.floats(0, 1, width=width) | st.just(-0.0),
    }
    open_intervals = {
        "vignetting": st.floats(-1, 1, width=width, exclude_max=True),
        "least_weight": st.floats(0, 1, width=width, exclude_max=True),
        "fov": st.floats(0, 180, width=width, exclude_min=True, exclude_max=True),
    }
    any_float = st.floats(-most, most, width=width)
    return open_intervals.get(attribute.name, intervals.get(attribute.limit, any_float))


@st.composite
def scene_rows(draw, width):
    """The blocks of any scene without pictures that the format can say, as `Scene.from_dict` takes them."""

    def names(count):
        return draw(st.lists(block_names(), max_size=count, unique=True))

    def value(attribute):
        numbers = [draw(values_of(attribute, width)) for _ in range(attribute.value_count)]
        if attribute.limit is NOT_ALL_ZERO and not any(numbers):
            numbers[0] = 1.0
        return tuple(numbers) if attribute.components else numbers[0]

    def block(row, name, **said):
        others = {one.name: value(one) for one in row.attributes if one.name not in said}
        return {"block": row.keyword, "name": name, **said, **others}

    kind = draw(st.sampled_from(BLOCK_TYPES["camera"]))
    camera = block(kind, draw(block_names()))
    if kind.complaint(camera) and "lookat" in kind.complaint(camera)[0]:
        camera |= {"viewpoint": (0.0, 0.0, 5.0), "lookat": (0.0, -0.0, 0.0), "up": (0.0, 1.0, 0.0)}
    if kind.complaint(camera):
        camera["distortion"] = tuple(map(abs, camera["distortion"]))
    found = [camera]
    for keyword, said in {"settings": {}, "film": {}, "background": {"texture": None}}.items():
        found += [block(BLOCK_TYPES[keyword][0], draw(block_names()), **said)] if draw(st.booleans()) else []
    found += [block(BLOCK_TYPES["light"][0], name) for name in names(3)]
    boards = names(3)
    found += [block(BLOCK_TYPES["texture"][0], name) for name in boards]
    textures = {name: draw(st.sampled_from([None, *boards])) for name in names(4)}
    plain = [name for name, texture in textures.items() if texture is None]
    for name, texture in textures.items():
        found.append(block(draw(st.sampled_from(BLOCK_TYPES["material"])), name, texture=texture))
    keywords = ["plane", "rectangle", *(["sphere"] if plain else [])]
    for name in names(4) if textures else ():
        keyword = draw(st.sampled_from(keywords))
        said = {"material": draw(st.sampled_from(plain if keyword == "sphere" else list(textures)))}
        if keyword == "rectangle":
            # One side along an axis, the other anywhere across it: exactly orthogonal.
            positive = st.floats(2**-10, 2**10, width=width)
            right = (draw(positive) * draw(st.sampled_from([1, -1])), 0.0, -0.0)
            up, axes = (0.0, draw(positive), draw(values_of(Attribute(""), width))), draw(st.permutations(range(3)))
            said |= {"right": tuple(right[k] for k in axes), "up": tuple(up[k] for k in axes)}
        found.append(block(BLOCK_TYPES[keyword][0], name, **said))
    return found


@pytest.mark.parametrize(
    ("model", "dtype"), [("classic", np.float32), ("additive", np.float64), ("physical", np.float32)]
)
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_formatting_then_parsing_is_exact(model, dtype, data):
    with jax.enable_x64(True):
        rows = data.draw(scene_rows(np.finfo(dtype).bits))
        scene = Scene.from_dict({"model": model, "blocks": rows}, dtype=dtype)
        text = format_scene(scene, model=model)
        again = parse_scene(text, dtype=dtype, model=model)
        assert_same_scene(again, scene)
        assert format_scene(again, model=model) == text


@given(st.integers(0, 2**32 - 1))
# Its shortest float32 text, 7.038531e-26, read as float64 and rounded again gives the neighbour.
@example(0x15AE43FD)
@settings(max_examples=100, deadline=None)
def test_a_float32_survives_its_text(bits):
    number = np.float32(np.uint32(bits).view(np.float32))
    assume(np.isfinite(number))
    assert np.float32(float(format_number(number))).tobytes() == number.tobytes()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.float32(0.1), "0.1"),
        (np.float64(np.float32(0.1)), "0.10000000149011612"),
        (np.float64(-0.0), "-0"),
        (np.float64(5e-324), "5e-324"),
        (np.float64(1e-5), "0.00001"),
    ],
)
def test_numbers_are_written_short(value, text):
    assert format_number(value) == text


def test_the_assignment_scene_is_canonical():
    with jax.enable_x64(True):
        path = DATA / "vitreous.txt"
        scene = load_scene(path, dtype=np.float64)
        text = path.read_text(encoding="utf-8")
        assert format_scene(scene, comments=text) == text
        assert scene.camera.pixeldim == (640, 480)
        assert scene.lights.names == ("centerback", "backleft", "topright")
        assert scene.shape_order == ("leftwall", "rightwall", "floor", "upperright", "central", "vitreous")
        vitreous = scene.spheres.names.index("vitreous")
        glass = scene.spheres.material[vitreous]
        assert scene.materials.names[glass] == "cyan"
        assert float(scene.materials.ior[glass]) == 1.337
        assert scene.spheres.center[:, vitreous].tolist() == [4.3, 2.3, -1.0]
        assert scene.materials.ior.tolist() == [1.0, 1.0, 1.0, 1.337, 1.0, 1.0]
        assert scene.planes.normal[:, 1].tolist() == [-3.0, 0.0, 1.0]


SPACED = """
camera eye {
    pixeldim 4 3
    worlddim 8 6
    viewpoint 4 3 6
}
sphere ball { material glass center 1 2 -3 radius .5 }
material glass { ior 1.5 }
plane floor { material glass normal 0 1 0 point 0 0 0 }
"""


@pytest.mark.parametrize(
    "text",
    [
        SPACED.replace(" {", "{"),
        SPACED.replace("{ ", "{").replace(" }", "}"),
        " ".join(SPACED.split()),
        "\n".join(SPACED.split()),
        "\t\v\f".join(SPACED.split()),
        SPACED.replace("\n", "\r\n"),
        SPACED.replace("\n", "\r"),
        "\ufeff" + SPACED,
        SPACED.replace("}\n", "}"),
        SPACED.replace(".5", "5E-1").replace("1 2 -3", "+1 2. -3.0"),
    ],
)
def test_any_spacing_reads_the_same(text):
    assert_same_scene(parse_scene(text), parse_scene(SPACED))


def test_worldim_is_read_with_a_warning():
    with pytest.warns(RaytraceWarning, match=r"^old\.txt:1:27: 'worldim'"):
        scene = parse_scene(CAMERA.replace("worlddim", "worldim"), source="old.txt")
    assert_same_scene(scene, parse_scene(CAMERA))
    assert "worlddim 8 6" in format_scene(scene)


ATTRIBUTES = {attribute.name for kinds in BLOCK_TYPES.values() for kind in kinds for attribute in kind.attributes}
WORDS = [*BLOCK_TYPES, *sorted(ATTRIBUTES), *CAMERA.split(), "{", "}", "1", "-2.5", "nan", "#", "é", "\ufeff", "red"]


@given(st.lists(st.sampled_from(WORDS), max_size=30), st.booleans())
@settings(max_examples=100, deadline=None)
def test_any_words_give_a_scene_or_an_error(words, with_camera):
    text = " ".join([CAMERA] * with_camera + words)
    try:
        scene = parse_scene(text)
    except ModelFileError as error:
        assert str(error).startswith("<string>:1:")
    else:
        assert_same_scene(parse_scene(format_scene(scene)), scene)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("name", name) for name in ("", "two words", "a{", "#a", "//a", "a\n")),
        ("viewpoint", np.nan),
        ("viewpoint", np.inf),
    ],
)
def test_only_what_reads_back_is_written(field, value):
    scene = parse_scene(CAMERA)
    with jax.debug_nans(False):
        value = value if field == "name" else jnp.full(3, value, scene.camera.viewpoint.dtype)
    camera = dataclasses.replace(scene.camera, **{field: value})
    with pytest.raises(ModelFileError, match=f"camera.*{field}"):
        format_scene(dataclasses.replace(scene, camera=camera))


def test_only_defaults_are_omitted():
    scene = parse_scene(CAMERA + "material plain { alpha 0 ior 1 } material odd { alpha -0 }")
    text = format_scene(scene)
    assert "material plain {\n}\n" in text
    assert "material odd {\n    alpha -0\n}\n" in text
