"""The plan of a batch, checked before any work: its names exist in every scene, its values are possible there."""

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from ..errors import reworded
from ..inverse.build_problem import OfViews, of_each_view
from ..inverse.options import FitOptions
from ..inverse.problem.fixed import numbers_of, standard_deviation
from ..scene.parameters import scalar_names, set_parameters
from ..scene.reader import load_scene
from ..scene.scene import Scene, fingerprint
from ..scene.setting_words import MAX_SAMPLES, EdgeMode
from ..scene.writer import format_scene
from ..tracer.settings import Precision, RenderSettings, ResolvedSettings, resolve_settings
from ..util.checked import Checked, Wanted, hints
from ..util.files import read_bytes
from .plan_file import RANGE, Keys, PlanError, PlanFile, Value, read_value, read_values, shown

Values = Mapping[str, Value]  # Of parameters, by name.

JobKind = Literal["render", "gradient", "fit"]


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
            for camera in scene.cameras:
                with reworded(self._of_scene(("settings", "crop"), f"of {name}")):
                    settings.window(scene.seen_by(camera).camera.pixeldim)
            text, folder = format_scene(scene, model=settings.model), str(path.parent.absolute())
            self.planned[name] = PlannedScene(text, settings, folder, fingerprint(scene))

    def _of_scene(self, keys: Keys, which: str) -> Callable[[str], PlanError]:
        return lambda words: self.file.error(keys, f"{words.rstrip('.')} ({which}).")

    def each(self, keys: Keys, attempt: Callable[..., Any], *arguments: Any) -> None:
        """Try something on every scene. Raises PlanError about the value in the plan where a parameter cannot be so."""
        for name, scene in self.by_name.items():
            with reworded(self._of_scene(keys, f"in {name}")):
                attempt(scene, *arguments)


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
    targets: Annotated[
        tuple[str | Mapping[str, str], ...],
        Wanted('an array of file names, or of tables, { left = "a.png", right = "b.png" }, of the scene\'s cameras'),
    ] = ()
    """Files of targets, of several cameras by their names; without them targets are rendered, with the job's values."""
    target_samples: Annotated[int, Wanted(least=1, most=MAX_SAMPLES)] = 4
    """N x N rays in each pixel of a rendered target."""
    noise: Annotated[tuple[float, ...], Wanted("numbers from 0 up", least=0, below=math.inf, nonempty=True)] = (0.0,)
    """Standard deviations of the noise that is added to the targets."""
    seeds: Annotated[tuple[int, ...], Wanted("whole numbers from 0 up", least=0, nonempty=True)] = (0,)
    """Of the noise."""


Task = tuple[Mapping[str, Any], OfViews[str]]
"""All that determines a job beside its scene, as plain values that JSON can hold, and the path of a fit's target."""


def read_fit(file: PlanFile, scenes: PlanScenes, fixed: Values) -> list[Task]:
    """The fits of one scene and its values, after a check of their table; `fixed` is the same in all jobs."""
    file.table(("fit",), known=(*hints(FitTable), "start", *OPTIONS))
    table, options = file.read(("fit",), FitTable, hints(FitTable)), file.read(("fit",), FitOptions, OPTIONS)
    scenes.each(("fit", "free"), scalar_names, table.free)
    start = {}
    for name, (keys, value) in file.parameters(("fit", "start")).items():
        start[name] = read_value(file, keys, value)
        scenes.each(keys, set_parameters, {name: start[name]})
    for option in ("ties", "priors"):
        for name, (keys, value) in file.parameters(("fit", option)).items():
            for parameter in (name, value) if option == "ties" else (name,):
                scenes.each(keys, scalar_names, [parameter])
    for name, (keys, amount) in file.parameters(("fit", "uncertain")).items():
        scenes.each(keys, _standard_deviations, name, amount)
    for given in table.targets:
        scenes.each(("fit", "targets"), of_each_view, "a picture", given)
    targets = [_read_target(file, given) for given in table.targets]
    common = {"free": list(table.free), "start": start, **{name: getattr(options, name) for name in OPTIONS}}
    # A rendered target takes the job's values, and the fit starts at the plan's; a file's fit starts at the job's.
    # Without noise a seed makes no difference.
    return [
        ({**common, **target, "noise": sigma, "seed": seed}, path)
        for target, path in targets or [({"target_samples": table.target_samples, "fixed": fixed}, "")]
        for sigma in table.noise
        for seed in (table.seeds if sigma > 0 else (None,))
    ]


def _read_target(file: PlanFile, given: OfViews[str]) -> Task:
    """What a target is, by its contents and by its name, and its path; of several cameras all by their names."""
    folder = file.path.parent.absolute()

    def contents(name: str) -> str:
        with reworded(lambda words: file.error(("fit", "targets"), f"{words}.")):
            return hashlib.sha256(read_bytes(folder / name)).hexdigest()

    if isinstance(given, str):
        return {"target": contents(given), "target_name": given}, str(folder / given)
    of_each = {camera: contents(name) for camera, name in given.items()}
    paths = {camera: str(folder / name) for camera, name in given.items()}
    return {"target": of_each, "target_name": "+".join(given.values())}, paths


def _standard_deviations(scene: Scene, name: str, amount: Any) -> list[float]:
    """Those of the numbers that a name stands for, where `amount` is stated of it."""
    return [standard_deviation(scene, address, name, amount) for address in numbers_of(scene, name)]


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


class BatchPlan(NamedTuple):
    """A plan file, read and checked."""

    scenes: Mapping[str, PlannedScene]  # By the names of their files in the plan.
    precision: Precision
    rows: Sequence[Values]  # The values of a job; each scene is made with all of them.
    work: Mapping[JobKind, tuple[dict[str, Any], Sequence[Task]]]
    """By the kind of job the settings that it changes, and what is done with each scene and row."""


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
    same = {name: value for name, (value,) in fixed.items()}
    combinations = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    work: dict[JobKind, tuple[dict[str, Any], Sequence[Task]]] = {}
    if "render" in file.data:
        work["render"] = {}, [({}, "")]
    if "gradient" in file.data:
        gradient = file.read(("gradient",), GradientPlan)
        scenes.each(("gradient", "wrt"), scalar_names, gradient.wrt)
        work["gradient"] = {"edges": gradient.edges, "aov": ()}, [({"wrt": list(gradient.wrt)}, "")]
    if "fit" in file.data:
        work["fit"] = {"edges": "point", "aov": ()}, read_fit(file, scenes, same)
    values = [{**same, **row, **combination} for row in _rows(file, rows) for combination in combinations]
    return BatchPlan(scenes.planned, head.precision, values, work)


def _columns(file: PlanFile, scenes: PlanScenes, table: str, names: list[str]) -> dict[str, tuple[Value, ...]]:
    """The values of each parameter in a table, possible in every scene.

    No number may be named twice, wherever and under whatever name: the `names` so far are those of other tables, too.
    """
    columns = {}
    for name, (keys, column) in file.parameters((table,), RANGE).items():
        columns[name] = (read_value(file, keys, column),) if table == "set" else read_values(file, keys, column)
        for value in columns[name]:
            scenes.each(keys, set_parameters, {name: value})
        names.append(name)
        scenes.each(keys, scalar_names, names)
    return columns


def _rows(file: PlanFile, columns: Mapping[str, tuple[Value, ...]]) -> tuple[Values, ...]:
    """The rows of the table `[list]`, whose columns have one length; one empty row if there is no such table."""
    first = next(iter(columns), "")
    for name, values in columns.items():
        if len(values) != len(columns[first]):
            wanted = f"{len(columns[first])} are wanted, as in {shown(first)}"
            keys, _ = file.parameters(("list",), RANGE)[name]
            raise file.error(keys, f"has {len(values)} values; {wanted}: the values of a list go together.")
    return tuple(dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)) or ({},)
