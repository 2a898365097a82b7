"""The plan of a batch, checked before any work: its names exist in every scene, its values are possible there."""

import dataclasses
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from ..errors import reworded
from ..inverse.options import FitOptions
from ..inverse.problem.fixed import numbers_of, standard_deviation
from ..scene.parameters import scalar_names, set_parameters
from ..scene.reader import load_scene
from ..scene.scene import Scene, fingerprint
from ..scene.setting_words import MAX_SAMPLES, EdgeMode
from ..scene.writer import format_scene
from ..tracer.resolved_settings import ResolvedSettings, resolve_settings
from ..tracer.settings import Precision, RenderSettings
from ..util.checked import Checked, Wanted, hints
from ..util.files import read_bytes
from .plan_file import RANGE, Keys, PlanError, PlanFile, Value, read_value, read_values, shown


class PlannedScene(NamedTuple):
    """A scene of a plan as its jobs have it, by its canonical text."""

    text: str
    settings: ResolvedSettings
    folder: str  # Where the paths of its textures begin.
    pictures: str  # A fingerprint of these; empty where it has none.


class PlanScenes:
    """The scenes that a plan file names, with the settings that it gives; each scene's file may say the others.

    Raises:
        PlanError: one comes twice, cannot be read, cannot have these settings, or is smaller than the crop.
    """

    def __init__(self, file: PlanFile, names: Sequence[str], given: RenderSettings):
        self.file, self.by_name, self.planned = file, dict[str, Scene](), dict[str, PlannedScene]()
        for name in names:
            if name in self.by_name:
                raise file.error(("scenes",), f"names {name} twice.")
            path = file.path.parent / name
            with reworded(partial(file.error, ("scenes",))):
                scene = self.by_name[name] = load_scene(path, model=given.model)
            with reworded(self._of_scene(("settings",), f"of {name}")):
                settings = resolve_settings(scene, given)
            with reworded(self._of_scene(("settings", "crop"), f"of {name}")):
                settings.window(scene.camera.pixeldim)
            text, folder = format_scene(scene, model=settings.model), str(path.parent.absolute())
            self.planned[name] = PlannedScene(text, settings, folder, fingerprint(scene))

    def _of_scene(self, keys: Keys, which: str) -> Callable[[str], PlanError]:
        return lambda words: self.file.error(keys, f"{words.rstrip('.')} ({which}).")

    def each(self, keys: Keys, attempt: Callable[[Scene], Any]) -> None:
        """Try something on every scene. Raises PlanError about the value in the plan where a parameter cannot be so."""
        for name, scene in self.by_name.items():
            with reworded(self._of_scene(keys, f"in {name}")):
                attempt(scene)


# In a plan `target_samples` is of targets that it renders; a fit finds out by itself what it was.
# Correlations come from a calibration, not from a text.
NOT_OPTIONS = ("profiles", "max_seconds", "target_samples", "correlations")
OPTIONS = tuple(field.name for field in dataclasses.fields(FitOptions) if field.name not in NOT_OPTIONS)
"""Options of a fit in a plan: a job draws no profiles, and its result does not depend on how fast the machine is."""


@dataclasses.dataclass(frozen=True)
class FitTable(Checked):
    """The table `[fit]` without the options of the fit itself."""

    free: Annotated[tuple[str, ...], Wanted('the names of parameters, as ["vitreous.ior"]', nonempty=True)]
    """The parameters to find."""
    targets: Annotated[tuple[str, ...], Wanted("an array of file names")] = ()
    """Files of targets; without them targets are rendered, with the values of the job."""
    target_samples: Annotated[int, Wanted(least=1, most=MAX_SAMPLES)] = 4
    """N x N rays in each pixel of a rendered target."""
    noise: Annotated[tuple[float, ...], Wanted("numbers from 0 up", least=0, below=math.inf, nonempty=True)] = (0.0,)
    """Standard deviations of the noise that is added to the targets."""
    seeds: Annotated[tuple[int, ...], Wanted("whole numbers from 0 up", least=0, nonempty=True)] = (0,)
    """Of the noise."""


@dataclasses.dataclass(frozen=True)
class FitPlan:
    table: FitTable
    start: Mapping[str, Value]  # Where the search begins, for parameters that are not to begin at the scene's value.
    targets: tuple[tuple[dict[str, str], str], ...]  # Names and SHA-256 of the files, as options, and their paths.
    options: FitOptions


def read_fit(file: PlanFile, scenes: PlanScenes) -> FitPlan:
    file.table(("fit",), known=(*hints(FitTable), "start", *OPTIONS))
    table, options = file.read(("fit",), FitTable, hints(FitTable)), file.read(("fit",), FitOptions, OPTIONS)
    scenes.each(("fit", "free"), lambda scene: scalar_names(scene, table.free))
    start = {}
    for name, (keys, value) in file.parameters(("fit", "start")).items():
        start[name] = read_value(file, keys, value)
        scenes.each(keys, lambda scene, name=name: set_parameters(scene, {name: start[name]}))
    for option in ("ties", "priors"):
        for name, (keys, value) in file.parameters(("fit", option)).items():
            for one in (name, value) if option == "ties" else (name,):
                scenes.each(keys, lambda scene, name=one: scalar_names(scene, [name]))
    for name, (keys, amount) in file.parameters(("fit", "uncertain")).items():
        scenes.each(
            keys,
            lambda scene, name=name, amount=amount: [
                standard_deviation(scene, address, name, amount) for address in numbers_of(scene, name)
            ],
        )
    targets = []
    for name in table.targets:
        path = file.path.parent.absolute() / name
        with reworded(lambda words: file.error(("fit", "targets"), f"{words}.")):
            digest = hashlib.sha256(read_bytes(path)).hexdigest()
        targets.append(({"target": digest, "target_name": name}, str(path)))
    return FitPlan(table, start, tuple(targets), options)


Values = Mapping[str, Value]  # Of parameters, by name.


@dataclasses.dataclass(frozen=True)
class Head(Checked):
    """The entries of a plan beside its tables."""

    scenes: Annotated[tuple[str, ...], Wanted('file names, as ["vitreous.txt"]', nonempty=True)]
    precision: Precision = 64


@dataclasses.dataclass(frozen=True)
class GradientPlan(Checked):
    """The table `[gradient]`: by which parameters, and whether edges that move are seen."""

    wrt: Annotated[tuple[str, ...], Wanted('the names of parameters, as ["vitreous.ior"]', nonempty=True)]
    edges: EdgeMode = "aware"


@dataclasses.dataclass(frozen=True)
class BatchPlan:
    scenes: Mapping[str, PlannedScene]  # By the names of their files in the plan.
    precision: Precision
    fixed: Values  # The same in all jobs.
    rows: tuple[Values, ...]  # Values that go together, one row at least.
    grid: Mapping[str, tuple[Value, ...]]  # All values of each parameter; jobs are made of all combinations.
    render: bool
    gradient: GradientPlan | None
    fit: FitPlan | None


def read_plan(path: Path) -> BatchPlan:
    """Read and check a plan file (docs/batch.md) and its scenes, in float64. Raises PlanError with file and name."""
    file = PlanFile(path)
    file.table((), known=(*hints(Head), "settings", "set", "grid", "list", "render", "gradient", "fit"))
    if not {"render", "gradient", "fit"} & set(file.data):
        raise file.error((), "says nothing to do: it needs one of the tables [render], [gradient] and [fit].")
    for name in file.table(("render",)):
        raise file.error(("render", name), "there is no such name. There are none.")
    head = file.read((), Head, hints(Head))
    scenes = PlanScenes(file, head.scenes, file.read(("settings",), RenderSettings))
    names: list[str] = []
    fixed, rows, grid = (_columns(file, scenes, table, names) for table in ("set", "list", "grid"))
    gradient = None
    if "gradient" in file.data:
        gradient = file.read(("gradient",), GradientPlan)
        scenes.each(("gradient", "wrt"), lambda scene: scalar_names(scene, gradient.wrt))
    return BatchPlan(
        scenes=scenes.planned,
        precision=head.precision,
        fixed={name: value for name, (value,) in fixed.items()},
        rows=_rows(file, rows),
        grid=grid,
        render="render" in file.data,
        gradient=gradient,
        fit=read_fit(file, scenes) if "fit" in file.data else None,
    )


def _columns(file: PlanFile, scenes: PlanScenes, table: str, names: list[str]) -> dict[str, tuple[Value, ...]]:
    """The values of each parameter in a table, possible in every scene.

    No number may be named twice, wherever and under whatever name: the `names` so far are those of other tables, too.
    """
    found = {}
    for name, (keys, value) in file.parameters((table,), RANGE).items():
        found[name] = (read_value(file, keys, value),) if table == "set" else read_values(file, keys, value)
        for one in found[name]:
            scenes.each(keys, lambda scene, name=name, one=one: set_parameters(scene, {name: one}))
        names.append(name)
        scenes.each(keys, lambda scene: scalar_names(scene, names))
    return found


def _rows(file: PlanFile, columns: Mapping[str, tuple[Value, ...]]) -> tuple[Values, ...]:
    """The rows of the table `[list]`, whose columns have one length; one empty row if there is no such table."""
    first = next(iter(columns), "")
    for name, values in columns.items():
        if len(values) != len(columns[first]):
            wanted = f"{len(columns[first])} are wanted, as in {shown(first)}"
            keys, _ = file.parameters(("list",), RANGE)[name]
            raise file.error(keys, f"has {len(values)} values; {wanted}: the values of a list go together.")
    return tuple(dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)) or ({},)
