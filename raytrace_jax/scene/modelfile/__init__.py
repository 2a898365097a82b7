"""Reading and writing the course's `model.txt` scene files."""

from raytrace_jax.scene.modelfile.format import format_scene as format_scene
from raytrace_jax.scene.modelfile.load import load_scene as load_scene
from raytrace_jax.scene.modelfile.load import parse_scene as parse_scene
