"""From a scene to a picture: plans the sizes, compiles, and sees that every ray finds room."""

import dataclasses

from raytrace_jax.scene.film import develop_compiled, without_idle
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.validity import check_values
from raytrace_jax.scene.values import is_traced
from raytrace_jax.tracer.film import Film
from raytrace_jax.tracer.memory import refuse_too_large
from raytrace_jax.tracer.programs.plan import Plan
from raytrace_jax.tracer.programs.plan_cache import PLANS, run_with_room, scene_kind
from raytrace_jax.tracer.programs.planning import few_runs, plan_render
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.resolved_settings import resolve_settings
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.compilation import jit


def render(scene: Scene, settings: RenderSettings | None = None, plan: Plan | None = None) -> Film:
    """Render a scene.

    Pure, and differentiable in forward and reverse mode with respect to every array of the scene. Under a
    transformation of JAX (`jit`, `grad`, `jvp`, `vmap`) the scene's values are not known while it is traced: let
    `make_renderer` plan first, or make the plan, `plan = plan_render(scene, settings)`, pass it, and see that
    `film.overflow` stays 0.

    Pixels are the colours at their points (or the mean of `samples` x `samples` of them), and their derivative is that
    of their areas: it contains what a pixel gains or loses as an edge moves across it, and is paid for only where it is
    asked for. `edges="point"` has the derivative of the points, which lacks that; `edges="aware"` has the values of
    areas as well.

    Args:
        scene: the scene; its arrays' dtype (float32 or float64) is that of the picture.
        settings: what to render; one compile for each. None is what the scene's file says.
        plan: sizes for the tracer's arrays. None takes the sizes that last served for such a scene, or makes new ones
            for programs that compile quickly. Programs with the sizes of `plan_render` or `make_renderer` take longer
            to compile and run faster.

    Returns:
        The film: `film.image`, the AOVs that were asked for, and `film.overflow`.

    Raises:
        ValueError: no plan although the scene is traced.
        SettingsError: a crop outside of the picture; a derivative is asked for, and the plan is for other settings.
        SceneError: an untraced number of the scene is not finite, or not a value that its attribute can have.
        PictureError: there is no memory for such a picture.
    """
    # Under a transformation of JAX no ray can be counted: the plan must be given. `overflow` tells if it is too small.
    settings = resolve_settings(scene, settings)
    settings.window(scene.camera.pixeldim)
    if is_traced(scene):
        if plan is None:
            raise ValueError("render() inside of a JAX transformation needs plan=plan_render(scene, settings)")
        return render_compiled(scene, settings, plan.for_loops())[0]

    # Else what cannot be rendered is refused first.
    check_values(scene)
    refuse_too_large(scene, settings)
    settings = settings.of_points

    # The tracer's program is the same with and without a film, and no effect that does nothing is computed.
    light = dataclasses.replace(scene, film=None)

    def program(plan):
        return render_compiled(light, settings, plan)

    def make_plan():
        return plan_render(light, settings, runs=few_runs(light, settings))

    # With a larger plan, until no ray lacks room; then the film's effects on the light.
    if plan is not None:
        film = run_with_room(program, plan, settings)[0]
    else:
        film = PLANS.run(program, scene_kind(light, settings), make_plan, settings)
    if scene.film is None:
        return film
    frame = settings.frame(scene.camera.pixeldim)
    return dataclasses.replace(film, image=develop_compiled(film.image, without_idle(scene.film), frame))


render_compiled = jit(render_planned, static_argnames=("settings", "plan"))
"""`render_planned`, compiled once for each of settings and plan."""
