"""Scenes that cannot be rendered are refused, those that are hardly meant are warned of; pictures likewise."""

import functools
from types import SimpleNamespace

import equinox as eqx
import jax
import numpy as np
import pytest
from fake_fit import VITREOUS
from scenes import resolved

from raytrace_jax import (
    RaytraceWarning,
    SceneError,
    load_scene,
    parse_scene,
    picture_derivatives,
    render,
)
from raytrace_jax.cli.preparation import read_picture_scene
from raytrace_jax.inverse.problem.observation import observe
from raytrace_jax.scene.checks import check_values, scene_warnings
from raytrace_jax.tracer.indistinct import indistinct_glass

SMALL = resolved(size=(4, 3))
CAMERA = "camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 }"


def with_radius(scene, radius):
    changed = np.array(scene.spheres.radius)  # JAX would refuse to make a NaN here.
    changed[1] = radius
    return eqx.tree_at(lambda tree: tree.spheres.radius, scene, changed)


@pytest.mark.parametrize("radius", [-1.0, 0.0, np.nan, np.inf])
def test_a_bad_scene_is_refused_by_render(radius):
    scene = with_radius(load_scene(VITREOUS), radius)
    name = scene.spheres.names[1]
    message = rf"^sphere '{name}': radius must be finite and greater than 0, not too small for float64, got {radius}\.$"
    for use in (render, lambda scene, settings: picture_derivatives(scene, [f"{name}.ior"], settings)):
        with pytest.raises(SceneError, match=message):
            use(scene, SMALL)


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        (lambda scene: scene.camera.viewpoint, [1.0, np.nan, 3.0], "camera 'cam1': viewpoint must be finite, got"),
        (lambda scene: scene.lights.emissivity, np.inf, "light .*: emissivity must be finite, got inf inf inf"),
        (lambda scene: scene.planes.normal, 0.0, "plane .*: normal must be finite and a vector other than 0 0 0"),
        (lambda scene: scene.materials.ior, 0.0, "material .*: ior must be finite and greater than 0, not .*, got 0.0"),
        (lambda scene: scene.spheres.radius, 5e-324, "sphere .*: radius must be .* not too small .* got 5e-324"),
        (lambda scene: scene.planes.normal, 1e-200, "plane .*: normal must be .* not too small for float64.* 1e-200"),
        (lambda scene: scene.camera.worlddim, np.float32(1e-12), "worlddim must be .*, not too small for float32"),
    ],
)
def test_every_number_is_looked_at(where, value, words):
    scene = load_scene(VITREOUS)
    broken = eqx.tree_at(where, scene, np.array(np.broadcast_to(value, where(scene).shape)))
    with pytest.raises(SceneError, match=words):
        check_values(broken)
    check_values(scene)


def test_traced_values_and_odd_weights_pass():
    scene = load_scene(VITREOUS)
    check_values(eqx.tree_at(lambda tree: tree.materials.alpha, scene, scene.materials.alpha + 1e-3))
    renderer = functools.partial(render, settings=SMALL)

    def picture(radius):
        return renderer(eqx.tree_at(lambda tree: tree.spheres.radius, scene, radius)).image

    jax.eval_shape(picture, -scene.spheres.radius)


def test_meaningless_attributes_are_named():
    (sentence,) = scene_warnings(load_scene(VITREOUS), "additive")
    assert sentence == "cyan.alpha means nothing to the additive model; --model classic has it."
    text = CAMERA + " light lamp { location 0 0 0 emissivity 1 1 1 energy 3 } material glass { ior 1.5 transmission 1 }"
    text += " sphere ball { material glass center 4 3 -3 radius 1 }"
    expected = "lamp.energy, glass.transmission mean nothing to the classic model; --model additive has them."
    assert scene_warnings(parse_scene(text), "classic") == [expected]
    assert scene_warnings(parse_scene(text, model="additive"), "additive") == []


def test_an_empty_or_flat_view_is_warned_of(capsys):
    scene = CAMERA.replace("4 3 6 }", "4 3 0 }")
    read_picture_scene(SimpleNamespace(scene=scene, assignments=(), render=SMALL, camera=None))
    assert capsys.readouterr().err.splitlines() == [
        "warning: the scene has no shapes: its picture is black.",
        "warning: the camera eye is in its image plane, z = 0: all of its rays lie in that plane.",
    ]


@pytest.mark.parametrize(
    ("model", "source", "lacks"),
    [
        ("classic", "", "no light block, no ambient colour"),
        ("classic", "light lamp { location 0 9 0 emissivity 1 1 1 }", None),
        ("physical", "", "no light block, no emission, no background"),
        ("physical", "background sky { radiance 0 0 1 }", None),
        ("physical", "background sky { radiance 0 0 0 }", "no light block, no emission, no background"),
        ("physical", "material lamp { emission 1 0 0 }", None),
    ],
)
def test_a_scene_without_light_is_told(model, source, lacks):
    scene = parse_scene(
        f"{CAMERA} {source} material m {{ }} sphere s {{ material m center 4 3 -1 radius 1 }}", model=model
    )
    expected = [f"the scene has no light ({lacks}): its picture is black."] if lacks else []
    assert scene_warnings(scene, model) == expected


def test_matt_without_a_light_is_told():
    words = "only light blocks shine on matt surfaces, and the scene has none."
    scene = """camera eye { pixeldim 3 3 viewpoint 0 0 9 lookat 0 0 0 } background sky { radiance 1 1 1 }
        material wall { diffuse 0.7 0.7 0.7 } material mirror { diffuse 0.1 0.1 0.1 reflectivity 0.9 }
        sphere a { material wall center 0 0 0 radius 1 } sphere b { material mirror center 9 0 0 radius 1 }"""
    one = parse_scene(scene, model="physical")
    assert scene_warnings(one, "physical") == [f"a is matt and black: {words}"]
    image = render(one).image
    assert np.all(image[:, 1, 1] == 0) and np.all(image[:, 0, 0] == 1)
    two = parse_scene(f"{scene} sphere c {{ material wall center 0 9 0 radius 1 }}", model="physical")
    assert scene_warnings(two, "physical") == [f"a, c are matt and black: {words}"]
    lit = parse_scene(f"{scene} light lamp {{ location 0 9 9 emissivity 1 1 1 }}", model="physical")
    assert scene_warnings(lit, "physical") == []


COLOURS = np.random.default_rng(0).uniform(size=(3, 3, 4))
GRAY = np.repeat(COLOURS[:1], 3, axis=0)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (np.round(255 * COLOURS), "colours go up to 2.., where white is 1: divide"),
        (255 * COLOURS, "colours go up to 2"),
        (GRAY, "the target is gray, and the scene has colours"),
    ],
)
def test_an_unlikely_target_is_warned_of(target, words):
    with pytest.warns(RaytraceWarning, match=words):
        observe(target, None, load_scene(VITREOUS), SMALL)


@pytest.mark.filterwarnings("error")
def test_a_likely_target_is_not_warned_of():
    scene = load_scene(VITREOUS)
    bright = COLOURS.copy()
    bright[:, 0, 0] = 300.0  # The picture of a lamp.
    for target in (COLOURS, bright, np.round(COLOURS)):
        observe(target, None, scene, SMALL)
    colourless = CAMERA + " material grey { ambient 1 1 1 } sphere ball { material grey center 4 3 -3 radius 1 }"
    observe(GRAY, None, parse_scene(colourless), SMALL)


def ball(name, material, radius, center="0 0 0"):
    return f"sphere {name} {{ material {material} center {center} radius {radius} }}"


def plane(name, material, normal, point="0 0 -3"):
    return f"plane {name} {{ material {material} normal {normal} point {point} }}"


def tube(name, radius, axis):
    return f"cylinder {name} {{ material crown center 4 0 0 axis {axis} radius {radius} }}"


def block(name, center="0 4 0", side=1.0, depth=0.5):
    return f"box {name} {{ material crown center {center} right {side} 0 0 up 0 {side} 0 depth {depth} }}"


def lens(name, curvature, thickness=0.9, diameter=2.0):
    return (
        f"lens {name} {{ material crown center 0 -4 0 axis 0 0 -1 curvature1 {curvature} curvature2 -0.1 "
        f"thickness {thickness} diameter {diameter} }}"
    )


@pytest.mark.parametrize(
    ("shapes", "eye", "told"),
    [
        ([ball("copy", "crown", 1)], 5, "the surfaces of ball and copy are less than 1e-05 units apart"),
        ([ball("hollow", "air", 0.999995)], 5, "the surfaces of ball and hollow are"),
        ([ball("core", "mirror", 0.999995)], 5, "the surfaces of ball and core are"),
        ([ball("hollow", "air", 0.99998)], 5, None),
        ([ball("touching", "crown", 1, "2 0 0")], 5, None),
        ([ball("one", "mirror", 1, "0 2 0"), ball("two", "mirror", 1, "0 2 0")], 5, None),
        ([plane("a", "crown", "0 0 2"), plane("b", "air", "0 0 1", "4 2 -3")], 5, "the surfaces of a and b are"),
        ([plane("a", "crown", "0 0 1"), plane("b", "air", "0 0 -1")], 5, None),
        ([], 1.000001, "the camera eye and the surface of ball are less than 1e-05 units apart"),
        ([plane("pane", "crown", "0 0 1", "3 0 5")], 5, "the camera eye and the surface of pane are less than 1e-05"),
        ([plane("wall", "mirror", "0 0 1", "3 0 5")], 5, None),
        ([tube("wall", 0.5, "0 0 0.9"), tube("liquid", 0.4, "0 0 0.9")], 5, "the surfaces of wall and liquid are"),
        ([tube("wall", 0.5, "0 0 0.9"), tube("liquid", 0.4, "0 0 -0.9")], 5, "the surfaces of wall and liquid are"),
        ([tube("wall", 0.5, "0 0 0.9"), tube("liquid", 0.5, "0 0 0.8")], 5, "the surfaces of wall and liquid are"),
        ([tube("wall", 0.5, "0 0 0.9"), tube("liquid", 0.4, "0 0 0.8")], 5, None),
        ([block("left"), block("right", "2 4 0")], 5, None),  # They stand on one level, and touch.
        ([block("left"), block("inner", "0 4 0.3", 0.5, 0.1)], 5, None),
        ([block("left"), block("inner", "0 4 0.3", 0.5, 0.2)], 5, "the surfaces of left and inner are"),
        ([block("left", "0 0 4.5")], 5, "the camera eye and the surface of left are less than 1e-05 units apart"),
        ([block("left", "3 0 4.5")], 5, None),  # The camera is in the plane of a face, beside it.
        ([lens("a", 0.4), lens("b", 0.3, diameter=1.5)], 5, "the surfaces of a and b are"),
        ([lens("a", 0.4), lens("b", 0.4, 0.7, 1.5)], 5, None),
    ],
)
def test_indistinct_glass_is_warned_of(shapes, eye, told):
    text = f"""camera eye {{ pixeldim 8 6 viewpoint 0 0 {eye} lookat 0 0 -5 }} background sky {{ radiance 1 1 1 }}
    material crown {{ transmission 1 ior 1.5 }} material air {{ transmission 1 ior 1 }}
    material mirror {{ reflectivity 1 }} {ball("ball", "crown", 1)} {" ".join(shapes)}"""
    assert not indistinct_glass(parse_scene(text.split("material")[0], model="physical"))  # Without shapes.
    found = indistinct_glass(parse_scene(text, model="physical", dtype=np.float64))
    assert len(found) == bool(told) and all(sentence.startswith(told) for sentence in found)
