"""The lessons are figures for teaching, made by the library itself, with the page that shows and explains them."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from matplotlib.figure import Figure

from raytrace_jax.report.lessons import formulas, pictures


class Lesson(NamedTuple):
    """A figure, its heading, and a paragraph of Markdown on what it shows."""

    title: str
    text: str
    draw: Callable[[], Figure]


LESSONS = {
    "snell": Lesson("Snell's law and its gradient", formulas.SNELL, formulas.draw_snell),
    "fresnel": Lesson("Fresnel and Schlick", formulas.FRESNEL, formulas.draw_fresnel),
    "critical": Lesson("The critical angle", formulas.CRITICAL, formulas.draw_critical),
    "ball": Lesson("A ray through a ball", formulas.BALL, formulas.draw_ball),
    "total_reflection": Lesson(
        "Total internal reflection, as automatic differentiation sees it",
        formulas.TOTAL_REFLECTION,
        formulas.draw_total_reflection,
    ),
    "edges": Lesson("A point does not see an edge move", pictures.EDGES, pictures.draw_edges),
    "cost": Lesson("What a search for the index walks on", pictures.COST, pictures.draw_cost),
}
"""Lessons by their names, in the order in which they build on each other."""


def index_page(names: Iterable[str]) -> str:
    """A Markdown page with a heading, the figure `NAME.png` and a paragraph for each of some lessons."""
    parts = ["# Refraction and its derivatives", "Made by `raytrace-jax teach`; angles are counted from the normal."]
    for name in names:
        lesson = LESSONS[name]
        parts += [f"## {lesson.title}", f"![{lesson.title}]({name}.png)", lesson.text]
    return "\n\n".join(parts) + "\n"
