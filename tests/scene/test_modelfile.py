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

from raytrace_jax import ModelFileError, ModelFileWarning, Scene, format_scene, load_scene, parse_scene
from raytrace_jax.scene import structs
from raytrace_jax.scene.schema import (
    NO_BLOCK,
    NOT_ALL_ZERO,
    NOT_NEGATIVE,
    POSITIVE,
    UNIT_INTERVAL,
    Attribute,
    declared_attributes,
)
from raytrace_jax.scene.table import ATTRIBUTE_NAMES, BLOCK_TYPES, SHAPE_KEYWORDS
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
    if attribute.value_type == "integer":
        whole = {"pixeldim": st.tuples(st.integers(1, 32768), st.just(1)), "max_bounces": st.integers(0, 64)}
        return whole.get(attribute.name, st.integers(1, 64)) | (st.none() if attribute.is_optional else st.nothing())
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
def scene_builders(draw, dtype, model):
    """Any scene that the format can say.

    Draws a function that builds the scene: the type checks of the scene's classes use `random`, which
    hypothesis forbids while it draws.
    """
    width = 32 if dtype is np.float32 else 64

    def names(count: int) -> tuple[str, ...]:
        return tuple(draw(st.lists(block_names(), max_size=count, unique=True)))

    def array(attribute, *columns: int):
        shape = (*attribute.shape, *columns)
        size = int(np.prod(shape))
        values = draw(st.lists(values_of(attribute, width), min_size=size, max_size=size))
        array = np.array(values, dtype).reshape(shape)
        if attribute.limit is NOT_ALL_ZERO:
            array = np.where(np.all(array == 0, axis=0), np.ones((), dtype), array)
        return jnp.asarray(array)

    def block(struct, **said):
        """What a struct of one block holds."""
        others = [one for one in declared_attributes(struct) if one.name not in said]
        numbers = {one.name: array(one) for one in others if one.value_type == "number"}
        words = {one.name: draw(values_of(one, width)) for one in others if one.name not in numbers}
        return {"name": draw(block_names()), **said, **numbers, **words}

    def blocks(struct, names, **said):
        """What a struct of blocks with these names holds, whose static values are said."""
        others = [one for one in declared_attributes(struct) if one.name not in said]
        return {"names": names, **said, **{one.name: array(one, len(names)) for one in others}}

    kind = draw(st.sampled_from([structs.ImagePlaneCamera, structs.PerspectiveCamera]))
    camera = block(kind)
    if kind is structs.PerspectiveCamera:
        (perspective,) = (row for row in BLOCK_TYPES["camera"] if row.struct is kind)
        found = perspective.complaint({name: np.asarray(value) for name, value in camera.items()})
        if found and "lookat" in found[0].attributes:
            views = {"viewpoint": (0, 0, 5), "lookat": (0, -0.0, 0), "up": (0, 1, 0)}
            camera |= {name: jnp.asarray(np.array(view, dtype)) for name, view in views.items()}
        if perspective.complaint({name: np.asarray(value) for name, value in camera.items()}):
            camera["distortion"] = jnp.abs(camera["distortion"])
    settings = draw(st.booleans()) and block(structs.FileSettings)
    background = draw(st.booleans()) and block(structs.Background, texture=NO_BLOCK)
    film = draw(st.booleans()) and block(structs.CameraResponse)
    lights, checkers = (blocks(struct, names(3)) for struct in (structs.PointLights, structs.Checkers))

    material_names = names(4)
    kinds = sorted(draw(st.integers(0, 2)) for _ in material_names)
    textures = [draw(st.integers(NO_BLOCK, len(checkers["names"]) - 1)) for _ in material_names]

    def materials(struct, number: int):
        places = [place for place, kind in enumerate(kinds) if kind == number]
        chosen = tuple(material_names[place] for place in places)
        return blocks(struct, chosen, texture=tuple(textures[place] for place in places))

    of_materials = [structs.Materials, structs.AbbeMaterials, structs.ChannelMaterials]
    material_rows = [materials(struct, number) for number, struct in enumerate(of_materials)]
    shape_order = names(4) if material_names else ()
    keywords = [draw(st.sampled_from(SHAPE_KEYWORDS)) for _ in shape_order]
    plain = [place for place, texture in enumerate(textures) if texture == NO_BLOCK]
    keywords = ["plane" if keyword == "sphere" and not plain else keyword for keyword in keywords]

    def shapes(struct, wanted: str, **said):
        chosen = tuple(name for name, keyword in zip(shape_order, keywords, strict=True) if keyword == wanted)
        able = plain if wanted == "sphere" else range(len(material_names))
        return blocks(struct, chosen, material=tuple(draw(st.sampled_from(able)) for _ in chosen), **said)

    # One side along an axis, the other anywhere across it: exactly orthogonal.
    axes = [draw(st.permutations(range(3))) for keyword in keywords if keyword == "rectangle"]
    sides = np.zeros((2, 3, len(axes)), dtype)
    positive, anything = Attribute("", limit=POSITIVE), Attribute("")
    for column, (first, second, third) in enumerate(axes):
        sides[0, first, column] = np.asarray(array(positive)) * dtype(draw(st.sampled_from([1, -1])))
        sides[1, [second, third], column] = [array(positive), array(anything)]
    right, up = map(jnp.asarray, sides)
    planes, spheres = shapes(structs.Planes, "plane"), shapes(structs.Spheres, "sphere")
    rectangles = shapes(structs.Rectangles, "rectangle", right=right, up=up)
    return lambda: Scene(
        model=model,
        settings=structs.FileSettings(**settings) if settings else None,
        camera=kind(**camera),
        film=structs.CameraResponse(**film) if film else None,
        background=structs.Background(**background) if background else None,
        lights=structs.PointLights(**lights),
        checkers=structs.Checkers(**checkers),
        images=structs.Images((), (), (), (), (), ()),
        materials=structs.Materials(**material_rows[0]),
        abbe_materials=structs.AbbeMaterials(**material_rows[1]),
        channel_materials=structs.ChannelMaterials(**material_rows[2]),
        planes=structs.Planes(**planes),
        spheres=structs.Spheres(**spheres),
        rectangles=structs.Rectangles(**rectangles),
        shape_order=shape_order,
    )


@pytest.mark.parametrize(
    ("model", "dtype"), [("classic", np.float32), ("additive", np.float64), ("physical", np.float32)]
)
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_formatting_then_parsing_gives_the_same_bits(model, dtype, data):
    with jax.enable_x64(True):
        scene = data.draw(scene_builders(dtype, model))()
        text = format_scene(scene, model=model)
        again = parse_scene(text, dtype=dtype, model=model)
        assert_same_scene(again, scene)
        assert format_scene(again, model=model) == text


@given(st.integers(0, 2**32 - 1))
# Its shortest float32 text, 7.038531e-26, read as float64 and rounded again gives the neighbour.
@example(0x15AE43FD)
@settings(max_examples=100, deadline=None)
def test_a_float32_survives_its_text_read_through_float64(bits):
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


def test_the_assignments_scene_is_stored_in_canonical_form():
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
def test_any_spacing_and_spelling_of_numbers_reads_the_same(text):
    assert_same_scene(parse_scene(text), parse_scene(SPACED))


def test_dtype_must_be_floating():
    with pytest.raises(TypeError, match="floating"):
        parse_scene(SPACED, dtype=np.int32)


def test_the_course_writers_worldim_is_read_with_a_warning_and_never_written():
    with pytest.warns(ModelFileWarning, match=r"^old\.txt:1:27: 'worldim'"):
        scene = parse_scene(CAMERA.replace("worlddim", "worldim"), source="old.txt")
    assert_same_scene(scene, parse_scene(CAMERA))
    assert "worlddim 8 6" in format_scene(scene)


WORDS = [*BLOCK_TYPES, *ATTRIBUTE_NAMES, *CAMERA.split(), "{", "}", "1", "-2.5", "nan", "#", "é", "\ufeff", "red"]


@given(st.lists(st.sampled_from(WORDS), max_size=30), st.booleans())
@settings(max_examples=100, deadline=None)
def test_any_words_give_a_scene_or_a_model_file_error(words, with_camera):
    text = " ".join([CAMERA] * with_camera + words)
    try:
        scene = parse_scene(text)
    except ModelFileError as error:
        assert str(error).startswith("<string>:1:")
    else:
        assert_same_scene(parse_scene(format_scene(scene)), scene)


@pytest.mark.parametrize("name", ["", "two words", "a{", "#a", "//a", "a\n"])
def test_a_name_that_would_not_read_back_is_not_written(name):
    scene = parse_scene(CAMERA)
    camera = dataclasses.replace(scene.camera, name=name)
    with pytest.raises(ModelFileError, match="camera name"):
        format_scene(dataclasses.replace(scene, camera=camera))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_would_not_read_back_is_not_written(value):
    scene = parse_scene(CAMERA)
    with jax.debug_nans(False):
        camera = dataclasses.replace(scene.camera, viewpoint=jnp.full(3, value, scene.camera.viewpoint.dtype))
    with pytest.raises(ModelFileError, match="viewpoint"):
        format_scene(dataclasses.replace(scene, camera=camera))


def test_defaults_are_not_written_but_a_negative_zero_is():
    scene = parse_scene(CAMERA + "material plain { alpha 0 ior 1 } material odd { alpha -0 }")
    text = format_scene(scene)
    assert "material plain {\n}\n" in text
    assert "material odd {\n    alpha -0\n}\n" in text
