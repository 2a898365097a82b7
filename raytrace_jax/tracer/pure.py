"""The picture as a pure function of the scene, for callers' own `jit`, `grad` and `vmap`: `make_renderer` offers it."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.errors import SceneError, SettingsError
from raytrace_jax.scene.checks import check_values
from raytrace_jax.scene.response import develop
from raytrace_jax.scene.scene import Scene, check_scene, map_scenes, without_texels
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.tracer.derivatives import develop_derivatives, not_differentiable, radiance_derivatives
from raytrace_jax.tracer.pixels import SceneFunction, picture_pixels, pixel_outputs
from raytrace_jax.tracer.rendering import Film, Image, refuse_too_large, render_concrete, render_radiance
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.run import NEEDS, Capacity, capacity_for, scene_key
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.checked import Wanted, suits
from raytrace_jax.util.compilation import jit
from raytrace_jax.util.numerics import instantiated, is_traced, is_zero, with_lower_ranks

USUAL_NEEDS = {"point": 10.0, "aware": 24.0}
"""Rays that a pixel of a batch may always want, by points and by areas: our own scenes want 1 to 9, and 3 to 22."""


def room_for(scene: Scene, settings: ResolvedSettings, slack: float) -> Capacity:
    """Room for a picture and its derivative: what is usual, or `slack` times what such a scene was seen to want."""
    if not suits(slack, float, Wanted(above=0, below=math.inf)):
        raise SettingsError(f"slack is {slack!r:.40}; a number greater than 0 is wanted.")
    settings, scene = settings.of_derivative.of_rays, dataclasses.replace(scene, film=None)
    # A part of a picture may have been seen, of sky alone: never less than what is usual.
    need = max(slack * NEEDS.get(scene_key(scene, settings), 0), USUAL_NEEDS[settings.edges or "aware"])
    return capacity_for(need, settings)


def measured_room(scene: Scene, settings: ResolvedSettings, slack: float) -> Capacity:
    """`room_for` a scene with concrete values that is traced for it."""
    pixels = picture_pixels(scene, settings)
    some = pixels._replace(points=pixels.points[:, :: 1 + pixels.points.shape[1] // 4096])
    scenes = map_scenes(lambda x: np.asarray(x)[None], dataclasses.replace(scene, film=None))
    pixel_outputs(scenes, some, settings.of_derivative.of_rays)
    return room_for(scene, settings, slack)


@with_lower_ranks
def pure_picture(scene: Scene, settings: ResolvedSettings, room: Capacity) -> Film:
    """The picture; without `edges` it is that of points, and its derivative that of areas."""
    film, frame = scene.film, settings.frame(scene.camera.pixeldim)
    scene = dataclasses.replace(scene, film=None)
    if settings.edges:
        radiance = render_radiance(differentiable_once(scene) if settings.edges == "aware" else scene, settings, room)
    else:
        # AOVs have no area: where there are some, their derivative is that of points.
        fixed = scene if settings.aov else jax.lax.stop_gradient(scene)
        points = render_radiance(fixed, settings.of_points, room)
        image, overflow = moved_by_areas(scene, points.image, points.overflow, settings, room)
        radiance = Film(image, points.aov, overflow)
    return dataclasses.replace(radiance, image=develop(radiance.image, film, frame))


compiled_picture = jit(pure_picture, static_argnames=("settings", "room"))


@functools.partial(jax.custom_jvp, nondiff_argnums=(3, 4))
def moved_by_areas(
    scene: Scene, image: Image, overflow: Int[Array, ""], settings: ResolvedSettings, room: Capacity
) -> tuple[Image, Int[Array, ""]]:
    """The radiance at the pixels' points with the derivative of their areas' means, and how many rays found no room.

    A point's colour jumps where an edge crosses it, so that its derivative lacks what edges sweep. The mean over an
    area changes by that too, and edge-aware tracing knows how. Only who differentiates pays for it.
    """
    return image, overflow


@moved_by_areas.defjvp
@with_lower_ranks
def _moved_by_areas(settings: ResolvedSettings, room: Capacity, primals, tangents):
    scene, image, overflow = primals

    def on_areas(scene: Scene):
        areas = dataclasses.replace(settings.of_derivative, aov=())
        radiance = render_radiance(differentiable_once(scene), areas, room)
        return radiance.image, radiance.overflow

    _, moved, more = jax.jvp(on_areas, (scene,), (tangents[0],), has_aux=True)
    return (image, overflow + more), (moved, np.zeros((), jax.dtypes.float0))


@jax.custom_jvp
def differentiable_once(scene: Scene) -> Scene:
    """The scene itself, whose derivatives must not be differentiated again: those of areas are estimates.

    The slopes of edges and the spreads of footprints are constants to the first derivative; a second one would lack
    what they change.
    """
    return scene


differentiable_once.defjvp(lambda primals, tangents: (not_differentiable(*primals), *tangents), symbolic_zeros=True)


@functools.partial(jax.custom_jvp, nondiff_argnums=(2, 3, 4))
def picture_at(
    y: Float[Array, " parameters"], scene: Scene, unknowns: SceneFunction, settings: ResolvedSettings, room: Capacity
) -> tuple[Image, Int[Array, ""]]:
    """The picture of a scene at the numbers `y`, and how many rays found no room.

    Each derivative that a transformation takes by itself would be another copy of the tracer in its program. All
    derivatives by `y` are products with one Jacobian, which rides along with the picture in forward mode.
    """
    film = compiled_picture(unknowns.moved(scene, y), settings, room)
    return film.image, film.overflow


def _picture_at_jvp(unknowns: SceneFunction, settings: ResolvedSettings, room: Capacity, primals, tangents):
    if is_zero(tangents[0]) or not is_zero(tangents[1]):
        # The scene's own numbers change too.
        plain = functools.partial(picture_at.fun, unknowns=unknowns, settings=settings, room=room)
        return jax.jvp(plain, primals, instantiated(tangents))
    image, jacobian, overflow = picture_jacobian(*primals, unknowns, settings, room)
    return (image, overflow), (jnp.tensordot(tangents[0], jacobian, 1), np.zeros((), jax.dtypes.float0))


picture_at.defjvp(_picture_at_jvp, symbolic_zeros=True)


@functools.partial(jit, static_argnames=("unknowns", "settings", "room"))
def picture_jacobian(
    y: Float[Array, " parameters"], scene: Scene, unknowns: SceneFunction, settings: ResolvedSettings, room: Capacity
) -> tuple[Image, Float[Array, "parameters 3 height width"], Int[Array, ""]]:
    image, jacobian, overflow = radiance_derivatives(y, scene, unknowns, settings, room)
    if scene.film is not None:
        frame = settings.frame(scene.camera.pixeldim)
        image, jacobian = develop_derivatives(image, jacobian, y, without_texels(scene), unknowns, frame)
    return image, jacobian, overflow


MOVING_SLACK = 1.3
"""Room for more rays than a scene was seen to want: its parameters move before a program must be compiled anew."""


class Renderer:
    """`renderer(scene)` is the scene's `Film`; see `make_renderer`."""

    def __init__(self, settings: ResolvedSettings, room: Capacity, model: ModelName):
        self.settings, self.room, self.model = settings, room, model

    def __call__(self, scene: Scene) -> Film:
        """The film of a scene of the same structure; pure and differentiable.

        With concrete values it never lacks room. Under a transformation of JAX the sizes are those of `room` when the
        program is traced: where rays find no room they are black, `film.overflow` counts them, and `grow` makes room.

        Raises:
            SceneError: the scene was loaded with another model than that which the renderer was made with; a number is
                not finite, or not a value that its attribute can have.
        """
        check_scene(scene)
        if scene.model != self.model:
            raise SceneError(
                f"this renderer was made with a scene of the {self.model} model, and this scene is of the "
                f"{scene.model} one: make a renderer for it, or load it with that model"
            )
        if is_traced(scene):
            return compiled_picture(scene, self.settings, self.room)
        check_values(scene)
        return render_concrete(scene, self.settings.of_points)

    def grow(self, scene: Scene) -> bool:
        """Make room for a scene that overflowed inside of a transformation. Returns whether there was too little.

        Functions that were traced before keep the old sizes: if this returns True, apply `jax.jit` to them anew.
        """
        if not self.room.lacks(measured_room(scene, self.settings, 1.0)):
            return False
        self.room = room_for(scene, self.settings, MOVING_SLACK)
        return True


def make_renderer(scene: Scene, settings: RenderSettings | None = None, slack: float = MOVING_SLACK) -> Renderer:
    """Make a renderer for all scenes of one structure; it works under `jax.jit`, `jax.grad`, `jax.jvp` and `jax.vmap`.

    The sizes of a program's arrays are chosen here, so that the scene may be traced afterwards::

        renderer = make_renderer(scene, settings)
        loss = lambda scene: ((renderer(scene).image - target) ** 2).mean()
        gradient = jax.jit(jax.grad(loss))(scene)

    Where the settings do not say `edges`, pixels are the colours at their points (or the mean of `samples` x `samples`
    of them), and their derivative is that of their areas: it contains what a pixel gains or loses as an edge moves
    across it, and is paid for only where it is asked for. `edges="point"` has the derivative of the points, which lacks
    that; `edges="aware"` has the values of areas as well. Second derivatives (`jax.hessian`) are those of points, with
    `edges="point"`; those of areas are refused.

    Args:
        scene: concrete values; scenes given to the renderer have the same structure.
        settings: what to render; None is what the scene's file says.
        slack: room for more rays than such a scene was last seen to want, as a factor.

    Returns:
        The renderer: `renderer(scene)` is the scene's film.

    Raises:
        ValueError: the scene is traced.
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have.
        PictureError: there is no memory for such a picture.
    """
    settings = resolve_settings(scene, settings)
    if is_traced(scene):
        raise ValueError("make_renderer() needs a scene's values: call it outside of JAX's transformations")
    check_values(scene)
    refuse_too_large(scene, settings)
    return Renderer(settings, room_for(scene, settings, slack), scene.model)
