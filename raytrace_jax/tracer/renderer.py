"""A renderer for one's own programs: a function of the scene that may be jitted, differentiated and batched at will."""

import dataclasses

from raytrace_jax.errors import SceneError
from raytrace_jax.scene.given import check_scene
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.validity import check_values
from raytrace_jax.scene.values import is_traced
from raytrace_jax.tracer.film import Film
from raytrace_jax.tracer.memory import refuse_too_large
from raytrace_jax.tracer.programs.plan import Plan
from raytrace_jax.tracer.programs.plan_cache import run_with_room
from raytrace_jax.tracer.programs.planning import MOVING_SLACK, plan_render
from raytrace_jax.tracer.rendering import render_compiled
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.settings import RenderSettings


class Renderer:
    """`renderer(scene)` is the scene's `Film`; see `make_renderer`.

    Attributes:
        settings: what is rendered.
        model: with which its scenes are loaded.
        plan: the sizes of the tracer's arrays; the renderer makes them larger when rays found no room.
        enlarged: how often it did.
    """

    def __init__(self, settings: ResolvedSettings, plan: Plan, model: ModelName):
        self.settings, self.plan, self.model, self.enlarged = settings, plan, model, 0

    def __call__(self, scene: Scene) -> Film:
        """The film of a scene of the same structure; pure and differentiable.

        With concrete values it never lacks room. Under a transformation of JAX the sizes are those of `plan` when the
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
            return render_compiled(scene, self.settings, self.plan.for_loops())[0]
        check_values(scene)
        return self._run(scene, self.settings.of_points)

    def _run(self, scene: Scene, settings: ResolvedSettings) -> Film:
        """Render concrete values by settings that say `edges`, with larger sizes where rays find no room."""
        derivative = self.plan.derivative if settings.edges == "aware" else None
        before = derivative or self.plan
        film, plan = run_with_room(lambda plan: render_compiled(scene, settings, plan), before, settings)
        if plan != before:
            self.plan = dataclasses.replace(self.plan, derivative=plan) if derivative else plan
            self.enlarged += 1
        return film

    def grow(self, scene: Scene) -> bool:
        """Enlarge the plan for a scene that overflowed inside of a transformation. Returns whether it was too small.

        Functions that were traced before keep the old sizes: if this returns True, apply `jax.jit` to them anew.

        Args:
            scene: with concrete values.
        """
        before = self.enlarged
        self(scene)
        if self.plan.derivative is not None:
            self._run(scene, self.settings.of_derivative)
        return self.enlarged > before


def make_renderer(scene: Scene, settings: RenderSettings | None = None, slack: float = MOVING_SLACK) -> Renderer:
    """Make a renderer for all scenes of one structure; it works under `jax.jit`, `jax.grad`, `jax.jvp` and `jax.vmap`.

    The sizes of the tracer's arrays are planned here, so that the scene may be traced afterwards::

        renderer = make_renderer(scene, settings)
        loss = lambda scene: ((renderer(scene).image - target) ** 2).mean()
        gradient = jax.jit(jax.grad(loss))(scene)

    Where the settings do not say `edges`, pixels are the colours at their points, and their derivative is that of their
    areas, as `render` tells: `jax.grad` contains what a pixel gains or loses as an edge moves across it.

    Args:
        scene: concrete values; scenes given to the renderer have the same structure.
        settings: what to render; None is what the scene's file says.
        slack: room for more rays than this scene has, as a factor.

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
        raise ValueError("make_renderer() plans with a scene's values: call it outside of JAX's transformations")
    settings.window(scene.camera.pixeldim)
    check_values(scene)
    refuse_too_large(scene, settings)
    return Renderer(settings, plan_render(scene, settings, slack), scene.model)
