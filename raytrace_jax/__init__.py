"""A differentiable Whitted ray tracer in JAX that reads the index of refraction off a picture."""

from .film import Film as Film
from .modelfile import format_scene as format_scene
from .modelfile import load_scene as load_scene
from .modelfile import parse_scene as parse_scene
from .parameters import get_parameter as get_parameter
from .parameters import list_parameters as list_parameters
from .parameters import set_parameters as set_parameters
from .pictures import read_picture as read_picture
from .plan import Plan as Plan
from .plan import plan_render as plan_render
from .render import render as render
from .scene import Scene as Scene
from .settings import RenderSettings as RenderSettings

__version__ = "0.1.0"
