"""Several scenes of one structure as one scene, whose arrays have the scenes as another first axis.

The texels of pictures have not: all scenes have them in common, however many there are.
"""

from collections.abc import Callable

import equinox as eqx
import jax

from raytrace_jax.scene.scene import Scene


def map_scenes(function: Callable, *scenes: Scene) -> Scene:
    """A function of the arrays of one or several scenes, as `jax.tree.map`; the texels are those of the first."""
    return with_texels(jax.tree.map(function, *(without_texels(scene) for scene in scenes)), scenes[0])


def without_texels(scene: Scene) -> Scene:
    """The scene with pictures of no texels: a program that only moves numbers need not copy them."""
    return eqx.tree_at(lambda scene: scene.images.texels, scene, ())


def with_texels(scene: Scene, other: Scene) -> Scene:
    """The scene with the texels of another one, not copied."""
    return eqx.tree_at(lambda scene: scene.images.texels, scene, other.images.texels)
