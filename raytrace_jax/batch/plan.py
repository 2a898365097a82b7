"""What a plan file asks for, checked: the names exist in every scene, and their values are possible there."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from raytrace_jax.batch.fit_plan import FitPlan, read_fit
from raytrace_jax.batch.plan_file import PlanFile, shown
from raytrace_jax.batch.plan_scenes import PlannedScene, PlanScenes
from raytrace_jax.batch.plan_values import RANGE, Value, read_value, read_values
from raytrace_jax.scene.parameters import scalar_names, set_parameters
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.tracer.settings import Precision, RenderSettings
from raytrace_jax.util.checked import Checked, Wanted, hints

TOP_LEVEL = ("scenes", "precision", "settings", "set", "grid", "list", "render", "gradient", "fit")
KINDS = ("render", "gradient", "fit")

Values = Mapping[str, Value]
"""Values of parameters by name."""


@dataclasses.dataclass(frozen=True)
class Head(Checked):
    """What stands in a plan beside its tables."""

    scenes: Annotated[tuple[str, ...], Wanted('file names, as ["vitreous.txt"]', some=True)]
    precision: Precision = 64


@dataclasses.dataclass(frozen=True)
class GradientPlan(Checked):
    """The table `[gradient]`: by which parameters, and whether edges that move are seen."""

    wrt: Annotated[tuple[str, ...], Wanted('the names of parameters, as ["vitreous.ior"]', some=True)]
    edges: EdgeMode = "aware"


@dataclasses.dataclass(frozen=True)
class BatchPlan:
    """A plan that makes sense.

    Args:
        scenes: each scene, by the name of its file in the plan.
        fixed: values of parameters that are the same in all jobs.
        rows: values of parameters that go together, one row at least.
        grid: all values of each parameter; jobs are made of all combinations.
        gradient, fit: what to differentiate and what to fit; None for nothing.
    """

    scenes: Mapping[str, PlannedScene]
    precision: Precision
    fixed: Values
    rows: tuple[Values, ...]
    grid: Mapping[str, tuple[Value, ...]]
    render: bool
    gradient: GradientPlan | None
    fit: FitPlan | None


def read_plan(path: Path) -> BatchPlan:
    """Read and check a plan file and the scenes that it names; docs/batch.md describes it. Numbers are read in float64.

    Raises:
        RaytraceError: the file cannot be read.
        PlanError: what it says makes no sense: the message has the file and the name.
    """
    file = PlanFile(path)
    file.refuse_unknown((), file.data, TOP_LEVEL)
    if not any(kind in file.data for kind in KINDS):
        raise file.error((), "says nothing to do: it needs one of the tables [render], [gradient] and [fit].")
    file.table(("render",), known=())
    head = file.read((), Head)
    file.table(("settings",), known=hints(RenderSettings))
    scenes = PlanScenes(file, head.scenes, file.read(("settings",), RenderSettings))
    fixed = {name: read_value(file, *found) for name, found in file.parameters(("set",)).items()}
    rows, grid = (
        {name: read_values(file, *found) for name, found in file.parameters((table,), RANGE).items()}
        for table in ("list", "grid")
    )
    _check_values(file, scenes, {"set": {name: (value,) for name, value in fixed.items()}, "list": rows, "grid": grid})
    return BatchPlan(
        scenes=scenes.planned,
        precision=head.precision,
        fixed=fixed,
        rows=_rows(file, rows),
        grid=grid,
        render="render" in file.data,
        gradient=_read_gradient(file, scenes) if "gradient" in file.data else None,
        fit=read_fit(file, scenes) if "fit" in file.data else None,
    )


def _check_values(file: PlanFile, scenes: PlanScenes, tables: Mapping[str, Mapping[str, tuple[Value, ...]]]) -> None:
    """Set each value in each scene; and no number may be named twice, wherever and under whatever name."""
    names: list[str] = []
    for table, columns in tables.items():
        places = file.parameters((table,), RANGE)
        for name, values in columns.items():
            keys, _ = places[name]
            for value in values:
                scenes.each(keys, lambda scene, name=name, value=value: set_parameters(scene, {name: value}))
            names.append(name)
            scenes.each(keys, lambda scene: scalar_names(scene, names))


def _rows(file: PlanFile, columns: Mapping[str, tuple[Value, ...]]) -> tuple[Values, ...]:
    """The rows of the table `[list]`, whose columns have one length; one empty row if there is no such table."""
    lengths = {name: len(values) for name, values in columns.items()}
    first = next(iter(lengths), "")
    for name, length in lengths.items():
        if length != lengths[first]:
            wanted = f"{lengths[first]} are wanted, as in {shown(first)}"
            keys, _ = file.parameters(("list",), RANGE)[name]
            raise file.error(keys, f"has {length} values; {wanted}: the values of a list go together.")
    return tuple(dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)) or ({},)


def _read_gradient(file: PlanFile, scenes: PlanScenes) -> GradientPlan:
    """The table `[gradient]`."""
    file.table(("gradient",), known=hints(GradientPlan))
    found = file.read(("gradient",), GradientPlan)
    scenes.each(("gradient", "wrt"), lambda scene: scalar_names(scene, found.wrt))
    return found
