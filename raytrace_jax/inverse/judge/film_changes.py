"""How a picture changes with what its film does: the numbers that are stated to be uncertain, and those suspected."""

import dataclasses
import math
from collections.abc import Container, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.scene.addresses import resolve
from raytrace_jax.scene.film import (
    FILM,
    FILM_EFFECTS,
    FilmEffect,
    FilmResponse,
    develop_compiled,
    neutral_film,
    without_idle,
)


class FilmChange(NamedTuple):
    """What a picture changes by with a number of its film, or with one number that all channels have in common.

    Args:
        name: the number's, `film.gain.r`; without a component that of all.
        effect: whose number it is.
        value: in the scene; of several the first one.
        change: of the picture, for an amount of one.
    """

    name: str
    effect: FilmEffect
    value: float
    change: Float[np.ndarray, "3 height width"]

    def amount(self, found: float) -> float:
        """An amount as a change of the number itself: effects that grow with a number's square are found as that."""
        if not self.effect.is_squared:
            return found
        square = self.value**2 + found
        # The target is sharper than a picture without blur: by as much as a blur would take away.
        return math.copysign(math.sqrt(abs(square)), square) - self.value


def suspected_changes(
    problem: Problem,
    y: Float[Array, " parameters"],
    light: Float[np.ndarray, "3 height width"],
    uncertain: Container[str] = (),
) -> list[FilmChange]:
    """Those by each of the film's numbers, but for what is free or uncertain, and by all channels together.

    Args:
        problem: what was fitted; a scene without a film has one that does nothing.
        y: the unknowns.
        light: the picture before the film.
        uncertain: canonical names of numbers that are stated to be uncertain.
    """
    film = film_at(problem, y)
    free = {resolve(problem.scene, name).address for name in problem.unknowns.names}
    leaders = {resolve(problem.scene, leader).address for _, leader in problem.unknowns.ties}
    alone = {(one.field, one.component) for one in free - leaders if one.group == FILM}
    tied = {(one.field, one.component) for one in leaders if one.group == FILM}
    before, found = developed(problem, light, film), []
    for effect in FILM_EFFECTS:
        value = np.asarray(getattr(film, effect.name), np.float64)
        for component, which in parts(effect):
            moving = {(effect.name, k if value.ndim else None) for k in which}
            # What is free alone is no suspect; of tied channels each is, but not all of them together.
            if moving <= alone or (len(moving) > 1 and moving & tied):
                continue
            name = f"{film.name}.{effect.name}{component}"
            if name in uncertain:
                continue
            start = float(np.atleast_1d(value)[which[0]])
            moved = start + effect.step if not effect.is_squared else math.hypot(start, effect.step)
            amount = effect.step if not effect.is_squared else effect.step**2
            after = developed(problem, light, with_numbers(film, effect, which, moved - start))
            found.append(FilmChange(name, effect, start, (after - before) / amount))
    return found


def stated_changes(
    problem: Problem,
    y: Float[Array, " parameters"],
    light: Float[np.ndarray, "3 height width"],
    uncertain: Mapping[str, float],
) -> list[FilmChange]:
    """Those by the film's numbers that are stated to be uncertain, for one of each number.

    Args:
        problem, y, light: as for `suspected_changes`.
        uncertain: standard deviation by canonical name of a fixed number. The change is that of moving by so much.
    """
    film = film_at(problem, y)
    found = []
    for effect in FILM_EFFECTS:
        value = np.atleast_1d(np.asarray(getattr(film, effect.name), np.float64))
        for k, component in enumerate(effect.attribute.components or ("",)):
            name = f"{film.name}.{effect.name}" + (f".{component}" if component else "")
            if name in uncertain:
                after = developed(problem, light, with_numbers(film, effect, [k], uncertain[name]))
                change = (after - developed(problem, light, film)) / uncertain[name]
                found.append(FilmChange(name, effect, float(value[k]), change))
    return found


def parts(effect: FilmEffect) -> Iterator[tuple[str, list[int]]]:
    """What of an effect may be off: all channels together, and each number on its own; its name and its places."""
    components = effect.attribute.components
    if len(components) == 3:
        yield "", [0, 1, 2]
    yield from ((f".{component}", [k]) for k, component in enumerate(components))
    if not components:
        yield "", [0]


def film_at(problem: Problem, y: Float[Array, " parameters"]) -> FilmResponse:
    """The film at the unknowns, with all effects."""
    return problem.scene_at(y).film or neutral_film(problem.observation.target.dtype)


def with_numbers(film: FilmResponse, effect: FilmEffect, which: list[int], by: float) -> FilmResponse:
    """The film with some of an effect's numbers moved."""
    value = np.array(getattr(film, effect.name))
    value.reshape(-1)[which] += by
    return dataclasses.replace(film, **{effect.name: value})


def developed(
    problem: Problem, light: Float[np.ndarray, "3 height width"], film: FilmResponse
) -> Float[np.ndarray, "3 height width"]:
    """What a film makes of the picture; effects that do nothing are left out."""
    active = without_idle(film)
    active = dataclasses.replace(
        active, **{e.name: problem.array(v) for e in FILM_EFFECTS if (v := getattr(active, e.name)) is not None}
    )
    return np.asarray(develop_compiled(problem.array(light), active, problem.frame()), np.float64)
