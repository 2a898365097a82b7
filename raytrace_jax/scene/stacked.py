"""Several scenes of one structure as one scene, whose arrays have the scenes as another first axis.

The texels of pictures have not: all scenes have them in common, however many there are.
"""

from collections.abc import Callable

import equinox as eqx
import jax

from raytrace_jax.scene.scene import Scene


def map_scenes(function: Callable, *scenes: Scene) -> Scene:
    """A function of the arrays of one or several scenes, as `jax.tree.map`; the texels are those of the first."""
    found = jax.tree.map(function, *(without_texels(scene) for scene in scenes))
    return eqx.tree_at(texels, found, scenes[0].images.texels)


def without_texels(scene: Scene) -> Scene:
    """The scene with pictures of no texels."""
    return eqx.tree_at(texels, scene, ())


def texels(scene: Scene):
    """The texels of each of a scene's pictures."""
    return scene.images.texels
