"""From a scene to a picture."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from raytrace_jax.scene.checks import check_values
from raytrace_jax.scene.response import develop_compiled, without_idle
from raytrace_jax.scene.rows import is_traced
from raytrace_jax.scene.scene import Scene, map_scenes
from raytrace_jax.tracer.film import Film
from raytrace_jax.tracer.memory import refuse_too_large
from raytrace_jax.tracer.pixels import mean_of_samples, picture_pixels, pixel_outputs
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.settings import RenderSettings


def render(scene: Scene, settings: RenderSettings | None = None) -> Film:
    """Render a scene.

    Pixels are the colours at their points (or the mean of `samples` x `samples` of them); `edges="aware"` has the
    values of areas. Within a transformation of JAX (`jit`, `grad`, `jvp`, `vmap`) use `make_renderer`.

    Args:
        scene: the scene, with concrete values; its arrays' dtype (float32 or float64) is that of the picture.
        settings: what to render. None is what the scene's file says. No size or crop compiles the tracer anew, nor does
            a number of point samples; the effects of a film are compiled for each size.

    Returns:
        The film: `film.image` and the AOVs that were asked for.

    Raises:
        ValueError: the scene is traced.
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have.
        PictureError: there is no memory for such a picture.
    """
    settings = resolve_settings(scene, settings)
    settings.window(scene.camera.pixeldim)
    if is_traced(scene):
        raise ValueError("render() needs a scene's values: inside of a JAX transformation use make_renderer(scene)")
    check_values(scene)
    refuse_too_large(scene, settings)
    return render_concrete(scene, settings.of_points)


def render_concrete(scene: Scene, settings: ResolvedSettings) -> Film:
    """The film of a scene that was checked, by settings that say `edges`."""
    _, _, width, height = settings.window(scene.camera.pixeldim)
    scenes = map_scenes(lambda x: np.asarray(x)[None], scene)
    pixels = picture_pixels(scene, settings)
    step = pixels.step if settings.edges == "aware" else None

    def outputs(points, aov):
        return pixel_outputs(scenes, points, dataclasses.replace(settings, aov=aov), step)

    # The mean over the samples, and the variables of the pixels' own points.
    if settings.samples == 1:
        found = outputs(pixels.points, settings.aov)
    else:
        [mean] = mean_of_samples(pixels, settings.samples, lambda points: [outputs(points, ())["color"]])
        found = (outputs(pixels.points, settings.aov) if settings.aov else {}) | {"color": mean}
    # Put there as they are: `jnp.asarray` would compile a program for each size.
    aov = jax.device_put({name: x[0].reshape(*x.shape[1:-1], height, width) for name, x in found.items()})
    image = aov.pop("color")

    # No effect of the film that does nothing is computed.
    if scene.film is not None:
        image = develop_compiled(image, without_idle(scene.film), settings.frame(scene.camera.pixeldim))
    return Film(image, aov, jnp.zeros((), jnp.int32))
