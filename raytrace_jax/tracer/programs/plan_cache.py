"""Plans that served, so that a moved parameter neither plans nor compiles anew; and larger ones where rays lack room.

A plan is a matter of room: it decides how long a render takes and what has to be compiled, never what it shows.
"""

import dataclasses
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from typing import TypeVar
from weakref import WeakValueDictionary

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.programs.plan import SLACK, Plan, Shares, Wanted, level_capacities, make_plan, too_many
from raytrace_jax.tracer.programs.planning import plan_render
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

T = TypeVar("T")

Program = Callable[[Plan], tuple[T, Wanted]]
"""From a plan to a result and the rays wanted at each level, as `tiles.render_planned`."""

SAMPLED = 16
"""At most so many scenes are counted to plan for all of a sequence."""


class PlanCache:
    """The plans used last, by the kind of what they are for; several threads may share it."""

    # A fit uses about ten plans. A plan takes a hundred bytes, what it compiled megabytes.
    def __init__(self, most: int = 256):
        self.most = most
        self.plans: OrderedDict[Hashable, Plan] = OrderedDict()
        self.lock = threading.Lock()
        self.planning: WeakValueDictionary[Hashable, threading.Lock] = WeakValueDictionary()

    def get(self, kind: Hashable) -> Plan | None:
        """The plan that served last for this kind, if it is still remembered."""
        with self.lock:
            if kind in self.plans:
                self.plans.move_to_end(kind)
            return self.plans.get(kind)

    def keep(self, kind: Hashable, plan: Plan) -> None:
        """Remember a plan; of too many the one that was not used for longest is forgotten."""
        with self.lock:
            self.plans[kind] = plan
            self.plans.move_to_end(kind)
            while len(self.plans) > self.most:
                self.plans.popitem(last=False)

    def plan(self, kind: Hashable, make_plan: Callable[[], Plan]) -> Plan:
        """The plan that served last for this kind, or a new one, made once however many threads ask for it."""
        with self.lock:
            planning = self.planning.setdefault(kind, threading.Lock())
        with planning:
            plan = self.get(kind)
            if plan is None:
                plan = make_plan()
                self.keep(kind, plan)
            return plan

    def run(
        self,
        program: Program[T],
        kind: Hashable,
        make_plan: Callable[[], Plan],
        settings: ResolvedSettings,
    ) -> T:
        """Run a program with the plan that served its kind last, or a new one, and remember the one that serves.

        Args:
            program: what to run.
            kind: as `scene_kind`, and whatever else the sizes depend on.
            make_plan: the plan to begin with where none is remembered.
            settings: what is rendered.
        """
        result, plan = run_with_room(program, self.plan(kind, make_plan), settings)
        self.keep(kind, plan)
        return result


PLANS = PlanCache()
"""The plans of this process."""


def scene_kind(scene: Scene, settings: ResolvedSettings) -> Hashable:
    """What scenes and settings have in common that can share a plan."""
    light = dataclasses.replace(scene, film=None)  # What is traced: a film comes after it.
    return settings, jax.tree.structure(light), scene.camera.viewpoint.dtype, jax.device_count()


def plan_ahead(scenes: Sequence[Scene], settings: ResolvedSettings) -> None:
    """Remember a plan that holds the rays of all these scenes, so that rendering them compiles once.

    At most `SAMPLED` of them are counted, spread evenly over the sequence; a scene that needs more room than these is
    planned anew, as ever. Where a plan for such scenes is remembered already, nothing changes.

    Args:
        scenes: one at least, all of one structure, with concrete values.
        settings: what will be rendered.
    """
    settings = settings.of_points
    kind = scene_kind(scenes[0], settings)
    if PLANS.get(kind) is None:
        places = np.unique(np.linspace(0, len(scenes) - 1, SAMPLED).round().astype(int))
        first, *others = (scenes[place] for place in places)
        PLANS.keep(kind, plan_render(first, settings, others=others))


def run_with_room(program: Program[T], plan: Plan, settings: ResolvedSettings) -> tuple[T, Plan]:
    """Run a program, with larger plans until no ray lacks room.

    Args:
        program: what to run.
        plan: the first plan to try.
        settings: what is rendered.

    Returns:
        The program's result, and the plan that served.
    """
    while True:
        result, wanted = program(plan)
        if not too_many(plan, wanted):
            return result, plan
        # More rays than room: enlarge each level to what was wanted of it, later ones at least in proportion.
        plan = enlarge(plan, wanted, settings)


def enlarge(plan: Plan, wanted: Wanted, settings: ResolvedSettings) -> Plan:
    """A plan that holds what the largest tile wanted, and more at levels that an overflow has hidden."""

    def share(capacities: tuple[int, ...], wanted: Int[Array, " levels"]) -> Float[np.ndarray, " levels"]:
        had, wants = np.zeros(wanted.shape[0]), np.asarray(wanted)
        had[: len(capacities)] = capacities
        growth = np.maximum.accumulate(np.maximum(wants / np.maximum(had, 1), 1) * (had > 0) + (had == 0))
        return np.maximum(wants, had * growth) / plan.tile_size

    edges = None
    if plan.edges is not None and wanted.edges is not None:
        edges = share(level_capacities(plan.edges), wanted.edges)
    shares = Shares(share(plan.capacities[1:], wanted.levels), edges)
    larger = make_plan(plan.tiles, plan.tile_size, shares, SLACK, settings, plan.runs)
    return dataclasses.replace(larger, on_all_devices=plan.on_all_devices, derivative=plan.derivative)
