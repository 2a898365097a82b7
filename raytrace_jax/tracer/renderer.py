"""A renderer for one's own programs: a function of the scene that may be jitted, differentiated and batched at will."""

from raytrace_jax.errors import SceneError
from raytrace_jax.scene.checks import check_values
from raytrace_jax.scene.rows import is_traced
from raytrace_jax.scene.scene import Scene, check_scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.tracer.film import Film
from raytrace_jax.tracer.memory import refuse_too_large
from raytrace_jax.tracer.pure import Room, compiled_picture, room_for
from raytrace_jax.tracer.rendering import render_concrete
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.settings import RenderSettings

MOVING_SLACK = 1.3
"""Room for the rays that a scene may grow while its parameters move, before a program must be compiled anew."""


class Renderer:
    """`renderer(scene)` is the scene's `Film`; see `make_renderer`.

    Attributes:
        settings: what is rendered.
        model: with which its scenes are loaded.
        room: the sizes of a program's arrays; `grow` makes them larger.
    """

    def __init__(self, settings: ResolvedSettings, room: Room, model: ModelName):
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

        Args:
            scene: with concrete values.
        """
        needed = room_for(scene, self.settings, 1.0)
        if not self.room.lacks(needed):
            return False
        self.room = room_for(scene, self.settings, MOVING_SLACK)
        return True


def make_renderer(scene: Scene, settings: RenderSettings | None = None, slack: float = MOVING_SLACK) -> Renderer:
    """Make a renderer for all scenes of one structure; it works under `jax.jit`, `jax.grad`, `jax.jvp` and `jax.vmap`.

    The sizes of a program's arrays are measured here, so that the scene may be traced afterwards::

        renderer = make_renderer(scene, settings)
        loss = lambda scene: ((renderer(scene).image - target) ** 2).mean()
        gradient = jax.jit(jax.grad(loss))(scene)

    Where the settings do not say `edges`, pixels are the colours at their points (or the mean of `samples` x `samples`
    of them), and their derivative is that of their areas: it contains what a pixel gains or loses as an edge moves
    across it, and is paid for only where it is asked for. `edges="point"` has the derivative of the points, which lacks
    that; `edges="aware"` has the values of areas as well.

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
        raise ValueError("make_renderer() measures a scene's values: call it outside of JAX's transformations")
    settings.window(scene.camera.pixeldim)
    check_values(scene)
    refuse_too_large(scene, settings)
    return Renderer(settings, room_for(scene, settings, slack), scene.model)
