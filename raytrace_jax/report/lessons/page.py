"""The lessons in their order, and the page that shows and explains them."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from matplotlib.figure import Figure

from raytrace_jax.report.lessons import ball, cost, critical, edges, fresnel, snell, total_reflection


class Lesson(NamedTuple):
    """A figure and one paragraph of what it shows.

    Args:
        title: a heading.
        text: the paragraph, Markdown.
        draw: makes the figure.
    """

    title: str
    text: str
    draw: Callable[[], Figure]


LESSONS = {
    "snell": Lesson("Snell's law and its gradient", snell.TEXT, snell.draw_snell),
    "fresnel": Lesson("Fresnel and Schlick", fresnel.TEXT, fresnel.draw_fresnel),
    "critical": Lesson("The critical angle", critical.TEXT, critical.draw_critical),
    "ball": Lesson("A ray through a ball", ball.TEXT, ball.draw_ball),
    "total_reflection": Lesson(
        "Total internal reflection, as automatic differentiation sees it",
        total_reflection.TEXT,
        total_reflection.draw_total_reflection,
    ),
    "edges": Lesson("A point does not see an edge move", edges.TEXT, edges.draw_edges),
    "cost": Lesson("What a search for the index walks on", cost.TEXT, cost.draw_cost),
}
"""Lessons by the names of their files, in the order in which they build on each other."""


def index_page(names: Iterable[str]) -> str:
    """A Markdown page with a heading, the figure `NAME.png` and a paragraph for each of some lessons."""
    parts = ["# Refraction and its derivatives", "Made by `raytrace-jax teach`; angles are counted from the normal."]
    for name in names:
        lesson = LESSONS[name]
        parts += [f"## {lesson.title}", f"![{lesson.title}]({name}.png)", lesson.text]
    return "\n\n".join(parts) + "\n"
