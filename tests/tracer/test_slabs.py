"""Slabs: the planes that they are to rays, Snell's law, and derivatives by their numbers."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import raytrace_jax as rj
from raytrace_jax import build
from raytrace_jax.tracer.settings import resolve_settings
from raytrace_jax.tracer.world import prepare_world

# Of light that is reflected twice nothing is seen.
SETTINGS = rj.RenderSettings(edges="point", least_weight=0.01, aov=("shape_index",))
EYE, FRONT, NORMAL, THICKNESS, WALL = np.array([0.5, 0.2, 8]), 1.0, np.array([0.2, 0, 1]), 2.0, 0.3
BENT = NORMAL / np.linalg.norm(NORMAL)
# Red grows to the right, and green is what of the light comes through.
RAMP = np.stack([np.tile(np.linspace(0, 1, 400), (2, 1)), np.ones((2, 400)), np.zeros((2, 400))])
NAMES = ("tank.thickness", "tank.wall", "tank.wall_ior", "tank.normal.x", "tank.point.z", "water.ior")


def before_a_board(*shapes):
    """The board comes first, and is of a type of material whose columns come after those of the slab's own."""
    return build.make_scene(
        build.camera("eye", pixeldim=(8, 6), viewpoint=EYE, lookat=(0, 0, 0), fov=20),
        build.texture("ramp", kind="image", file=RAMP),
        build.material("board", emission=(1, 1, 1), texture="ramp", ior=(1, 1, 1)),
        build.material("water", transmission=1, ior=1.33, absorption=(0.01, 0.01, 0.01)),
        build.material("acrylic", transmission=1, ior=1.49),
        build.material("nothing", transmission=1, ior=1),
        build.rectangle("wall", material="board", center=(0, 0, -3), right=(4, 0, 0), up=(0, 4, 0)),
        *shapes,
        model="physical",
        dtype=np.float64,
    )


SLAB = {"material": "water", "point": (0, 0, FRONT), "normal": 3 * NORMAL, "thickness": THICKNESS, "wall_ior": 1.49}
TANK = before_a_board(build.slab("tank", wall=WALL, **SLAB))


@pytest.mark.parametrize("wall", [WALL, 0.0])
def test_a_slab_is_its_planes(wall):
    depths = {"nothing": THICKNESS, "acrylic": THICKNESS - wall, "water": wall, "acrylic ": 0.0}
    planes = [
        build.plane(f"p{k}", material=name.strip(), normal=3 * NORMAL, point=[0, 0, FRONT] - depth * BENT)
        for k, (name, depth) in enumerate(depths.items())
    ]
    settings = resolve_settings(TANK, SETTINGS)
    found, expected = (
        prepare_world(scene, settings)
        for scene in (rj.set_parameters(TANK, {"tank.wall": wall}), before_a_board(*planes))
    )
    assert eqx.tree_equal(found, expected, rtol=1e-14, atol=1e-14)
    assert np.asarray(found.shapes.hidden).tolist() == [False, False, not wall, False, not wall]


@pytest.mark.parametrize("wall", [WALL, 0.0])
def test_a_slab_bends_light_by_snells_law(wall):
    """In the plane of incidence, a layer of thickness d shifts a ray by d (tan i - tan t) along the slab."""
    film = rj.render(rj.set_parameters(TANK, {"tank.wall": wall}), SETTINGS)
    # A pixel of the row that the camera's axis lies between sees about where its ray meets the board.
    forward = -EYE / np.linalg.norm(EYE)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    up, half = np.cross(right, forward), np.tan(np.radians(10))
    rows, columns = np.mgrid[:6, :8]
    across, high = half * ((2 * columns + 1) / 8 - 1), half * (6 / 8) * (1 - (2 * rows + 1) / 6)
    d = forward + across[..., None] * right + high[..., None] * up
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    cos = -(d @ BENT)[..., None]
    along = d + cos * BENT
    p = EYE + d * ((EYE - [0, 0, FRONT]) @ BENT / cos)
    for depth, ior in ((wall, 1.49), (THICKNESS - 2 * wall, 1.33), (wall, 1.49)):
        inner = along / ior
        p = p - depth * BENT + depth * inner / np.sqrt(1 - np.sum(inner**2, -1, keepdims=True))
    place = (p + d * ((-3 - p[..., 2:]) / d[..., 2:]))[..., 0]
    # The ramp goes from the middle of the first texel to that of the last.
    np.testing.assert_allclose(film.image[0] / film.image[1], ((place + 4) / 8 * 400 - 0.5) / 399, rtol=1e-9)
    assert np.all(film.aov["shape_index"] == 1), "the slab's own place in the file"


@pytest.mark.slow
def test_derivatives_by_a_slab_are_differences():
    points = rj.RenderSettings(edges="point", least_weight=0.01)
    found = np.asarray(rj.picture_derivatives(TANK, NAMES, points).values)
    for name, derivative in zip(NAMES, found, strict=True):
        value = float(TANK[name])
        ahead, behind = (
            np.asarray(rj.render(rj.set_parameters(TANK, {name: value + step}), SETTINGS).image)
            for step in (1e-6, -1e-6)
        )
        assert (abs(derivative).max() > 1e-3) != (name == "tank.point.z"), "light is shifted alike wherever a slab is"
        np.testing.assert_allclose(derivative, (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-6, err_msg=name)
    renderer = functools.partial(rj.render, settings=points)
    weights = np.random.default_rng(0).normal(size=found.shape[1:])

    def weighted(values):
        moved = rj.set_parameters(TANK, dict(zip(NAMES, values, strict=True)))
        return jnp.sum(weights * renderer(moved).image)

    backwards = jax.jit(jax.grad(weighted))(jnp.asarray([float(TANK[name]) for name in NAMES]))
    np.testing.assert_allclose(backwards, np.sum(found * weights, axis=(1, 2, 3)), rtol=1e-8, atol=1e-8)
    none = rj.set_parameters(TANK, {"tank.wall": 0.0})
    assert np.all(np.asarray(rj.picture_derivatives(none, NAMES, points).values)[[1, 2]] == 0), "a wall that is none"
