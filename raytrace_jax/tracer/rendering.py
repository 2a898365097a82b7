"""A picture from a scene, for concrete scenes and under every transformation of JAX."""

import dataclasses

from ..scene.checks import check_values
from ..scene.response import develop_compiled, without_idle
from ..scene.scene import Scene
from ..util.numerics import is_traced
from .film import Film
from .pure import pure_picture
from .radiance import refuse_too_large, render_radiance
from .resolved_settings import resolve_settings
from .settings import RenderSettings


def render(scene: Scene, settings: RenderSettings | None = None) -> Film:
    """Render a scene; `jax.jit`, `jax.grad`, `jax.jvp` and `jax.vmap` may be around it.

    The gradient by a scene is a scene::

        loss = lambda scene: ((render(scene, settings).image - target) ** 2).mean()
        gradient = jax.jit(jax.grad(loss))(scene)

    Where the settings do not say `edges`, pixels are the colours at their points (or the mean of `samples` x `samples`
    of them), and their derivative is that of their areas: it contains what a pixel gains or loses as an edge moves
    across it, and is paid for only where it is asked for. `edges="point"` has the derivative of the points, which lacks
    that; `edges="aware"` has the values of areas as well. Second derivatives (`jax.hessian`) are those of points, with
    `edges="point"`; those of areas are refused.

    Args:
        scene: its arrays' dtype (float32 or float64) is that of the picture.
        settings: what to render. None is what the scene's file says. Of concrete scenes no size or crop compiles the
            tracer anew, nor does a number of point samples; the effects of a film are compiled for each size.

    Returns:
        The film: `film.image` and the AOVs that were asked for.

    Raises:
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have; of a traced scene
            nobody knows.
        PictureError: there is no memory for such a picture.
        RuntimeError, ValueError: as JAX raises an error of a running program: a transformed picture wants more rays
            than `rays_per_pixel` of the settings. The message, within that of JAX, says what to state. Without a
            transformation there is room for all.
    """
    settings = resolve_settings(scene, settings)
    refuse_too_large(scene, settings)
    if is_traced(scene):
        return pure_picture(scene, settings)
    check_values(scene)
    radiance = render_radiance(scene, settings.of_points)
    if scene.film is None:
        return radiance
    # No effect of the response that does nothing is computed.
    frame = settings.frame(scene.camera.pixeldim)
    return dataclasses.replace(radiance, image=develop_compiled(radiance.image, without_idle(scene.film), frame))
