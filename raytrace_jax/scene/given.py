"""What a caller gives as a scene, and may have taken for one: the name of its file, its text, its path."""

import os

from raytrace_jax.errors import SceneError
from raytrace_jax.scene.scene import Scene
from raytrace_jax.util.text import quoted


def check_scene(given: object) -> None:
    """Refuse what is no scene.

    Raises:
        SceneError: says what it is, and how a scene is made of it.
    """
    if isinstance(given, Scene):
        return
    if isinstance(given, str) and "{" in given:
        raise SceneError("a scene is wanted, and this is the text of one: read it with parse_scene.")
    if isinstance(given, str | os.PathLike):
        name = quoted(os.fspath(given))
        raise SceneError(f"a scene is wanted, and this is the text {name}: load it with load_scene({name}).")
    raise SceneError(
        f"a scene is wanted, as load_scene and make_scene return it, and this is of the type {type(given).__name__}."
    )
