"""The blocks of bodies: what a file may say, who refuses it, and what is written of it."""

import json

import numpy as np
import pytest
from scenes import assert_same_scene

import raytrace_jax as rj
from raytrace_jax import build

HEAD = (
    "camera eye { pixeldim 8 6 viewpoint 0 0 5 lookat 0 0 0 } background sky { radiance 1 1 1 } "
    "texture squares { kind checker color1 0 0 0 color2 1 1 1 square 1 } material painted { texture squares } "
    "material glass { transmission 1 ior 1.5 } "
)
GLASS: dict = {"material": "glass"}
CENTER: dict = GLASS | {"center": (0.5, 0, -1)}
BODIES = {
    "box": CENTER | {"right": (1, 0, 0), "up": (0, 2, 0), "depth": 0.25},
    "prism": GLASS | {"point": (0, 1, 0), "axis": (0, 0, 2), "down": (0, -1, 0), "apex": 60},
    "cylinder": CENTER | {"axis": (0, 1, 0.5), "radius": 0.3},
    "half cylinder": CENTER | {"axis": (0, 1, 0.5), "radius": 0.3, "cut": (1, 0, 0)},
    "half sphere": CENTER | {"radius": 0.3, "cut": (1, 0, 0.1)},
    "lens": CENTER | {"axis": (0, 0, 3), "curvature1": 0.5, "curvature2": -0.25, "thickness": 1, "diameter": 2},
    "flat lens": CENTER | {"axis": (0, 0, 3), "curvature1": 0.5, "curvature2": 0, "thickness": 1, "diameter": 2},
}
WHOLE = ("box", "prism", "cylinder", "half sphere", "lens")


def block(body, **changed):
    """The lines of a body, with some of its values changed, or taken away by None."""
    values = {name: value for name, value in (BODIES[body] | changed).items() if value is not None}
    words = (
        f"{name} {value if isinstance(value, str) else ' '.join(map(str, np.ravel(value)))}"
        for name, value in values.items()
    )
    return f"{body.split()[-1]} it {{ {' '.join(words)} }}"


def parsed(text, dtype=np.float64):
    return rj.parse_scene(HEAD + text, model="physical", dtype=dtype)


@pytest.mark.parametrize(
    ("body", "changed", "words"),
    [
        (
            "lens",
            {"thickness": 0.2},
            "faces cross before the rim: at 1 from the axis .* thickness must be 0.39.* not 0.2",
        ),
        (
            "lens",
            {"diameter": 5},
            "curvature1 has a radius of 2 .* the rim, 2.5 .*: diameter may be 4, or curvature1 0.4",
        ),
        ("lens", {"curvature1": 0, "diameter": 10}, "diameter may be 8, or curvature2 -0.2"),
        ("lens", {"curvature1": -0.5}, "curvature1 must be 0 or greater .*no face of a lens is hollow.* got '-0.5'"),
        ("lens", {"curvature2": 0.5}, "curvature2 must be 0 or less .minus 1 over the radius.* got '0.5'"),
        ("lens", {"axis": (0, 0, 0)}, "axis must be a vector other than 0 0 0"),
        ("lens", {"radius1": 2}, "unknown attribute 'radius1' in lens 'it'. Valid .*curvature1, curvature2"),
        ("prism", {"apex": 180}, "apex must be greater than 0 and less than 180 degrees, got '180"),
        ("prism", {"apex": 0}, "apex must be greater than 0 and less than 180 degrees, got '0"),
        ("prism", {"axis": (0, 1, 1)}, "axis and down must be orthogonal, but the angle between them is 135 degrees"),
        ("half sphere", {"cut": (0, 0, 0)}, "in sphere 'it', cut must be a vector other than 0 0 0"),
        ("half cylinder", {"cut": (0, 0, 0)}, "in cylinder 'it', cut must be a vector other than 0 0 0"),
        ("box", {"up": (1, 1, 0)}, "right and up must be orthogonal, but the angle between them is 45 degrees"),
        (
            "box",
            {"cut": (0, 0, 1)},
            "unknown attribute 'cut' in box 'it'. Valid .*: material, center, right, up, depth",
        ),
        ("box", {"depth": None}, "box 'it' lacks depth. A box must have: material, center, right, up, depth"),
        ("box", {"depth": -1}, "depth must be greater than 0, got '-1"),
        ("cylinder", {"radius": 0}, "radius must be greater than 0, got '0"),
        *((body, {"material": "painted"}, "no mapping for the kind 'checker', as .* have") for body in WHOLE),
    ],
)
def test_bad_bodies_are_refused(body, changed, words):
    with pytest.raises(rj.ModelFileError, match=words):
        parsed(block(body, **changed))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("body", BODIES)
def test_bodies_are_what_is_written_of_them(body, dtype):
    scene = parsed(block(body), dtype)
    text = rj.format_scene(scene)
    assert_same_scene(rj.parse_scene(text, model="physical", dtype=dtype), scene)
    assert_same_scene(rj.Scene.from_dict(json.loads(json.dumps(scene.to_dict())), dtype=dtype), scene)
    others = build.camera("eye", pixeldim=(8, 6), viewpoint=(0, 0, 5), lookat=(0, 0, 0)), build.material("glass")
    built = rj.make_scene(
        *others, getattr(build, body.split()[-1])("it", **BODIES[body]), dtype=dtype, model="physical"
    )
    for name, wanted in BODIES[body].items():
        for made in (scene, built) if name != "material" else ():
            np.testing.assert_array_equal(made[f"it.{name}"], np.asarray(wanted, dtype), strict=True)


def test_numbers_of_bodies_go_by_name():
    scene = rj.set_parameters(parsed(block("prism")), {"it.apex": 45, "it.point.x": -0.5, "it.ior": 1.7})
    assert [float(scene[name]) for name in ("it.apex", "it.point.x", "glass.ior")] == [45, -0.5, 1.7]
    with pytest.raises(rj.ParameterError, match="apex must be greater than 0 and less than 180"):
        rj.set_parameters(scene, {"it.apex": 180})
    with pytest.raises(rj.ParameterError, match="must be orthogonal"):
        rj.set_parameters(scene, {"it.axis": (0, 1, 1)})
    with pytest.raises(rj.ParameterError, match="faces cross before the rim"):
        rj.set_parameters(parsed(block("lens")), {"it.thickness": 0.1})
