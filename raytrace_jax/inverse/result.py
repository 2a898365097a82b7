"""The result of a fit."""

import dataclasses
import functools
import html
import itertools
import math
from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from ..errors import ParameterError
from ..optics.dispersion import Dispersion
from ..scene.scene import Scene
from ..tracer.settings import ResolvedSettings
from ..util.digits import value_and_error, with_error
from ..util.files import StrPath
from ..util.numerics import root_diagonal
from ..util.text import aligned, did_you_mean, listed
from .dispersion import dispersion_words, fitted_dispersions
from .judge.model_check import Dependence, ModelCheck
from .judge.uncertainty import Uncertainty, correlation_of
from .judge.views import ViewAlone
from .problem.unknowns import Covariance, Image, Mask, Values
from .result_file import load_record

Status = Literal["converged", "ambiguous", "degenerate", "model_incomplete", "not_converged", "interrupted"]

ELLIPSE_95 = 5.991
"""95 % quantile of the chi-square distribution with two degrees of freedom: the ellipse of a pair of parameters."""

PROFILE_95 = 3.841
"""95 % quantile of the chi-square distribution with one degree of freedom: the interval of a profile."""


@dataclasses.dataclass(frozen=True)
class FitStep:
    """One step of the solver.

    Args:
        candidate: number of the start that it belongs to, from 0, in the order in which they were solved.
        level: number of the pyramid level, from 0, the coarsest.
        blur: standard deviation of that level's Gaussian blur, in the target's pixels; 0 on the last.
        step: number of the step within the level, from 0, the start.
        cost: half the sum of squared residuals on that level, after the step.
        value: the free parameters after the step, in the order of `FitResult.names`.
    """

    candidate: int
    level: int
    blur: float
    step: int
    cost: float
    accepted: bool
    value: Values
    seconds: float


@dataclasses.dataclass(frozen=True)
class Minimum:
    """A place at which a solve came to rest.

    Args:
        candidate: number of the start that led there, as in `FitStep`.
        rms_residual: root mean square of picture minus target there, over the pixels that count, on `level`.
        level: the pyramid level on which it was judged, as in `FitStep`.
        evidence: by how many standard errors the estimate explains the target better than this minimum (Vuong's test).
            Below 3, two minima that both explain the target cannot be told apart.
    """

    candidate: int
    value: Values
    rms_residual: float
    level: int
    explained: bool
    evidence: float


@dataclasses.dataclass(frozen=True)
class Profile:
    """The rise of chi-square when one parameter is held and all others are fitted again.

    Args:
        value: where it was held, increasing.
        chi_square: chi-square there, less that of the estimate; 3.84 bounds the 95 % interval.
        others: the free parameters there, one column for each value.
        interval: where `chi_square` reaches 3.84 on either side; infinite where it does not within the values.
    """

    name: str
    value: Float[np.ndarray, " points"]
    chi_square: Float[np.ndarray, " points"]
    others: Float[np.ndarray, "parameters points"]
    interval: tuple[float, float]


class Estimate(NamedTuple):
    """One number of the answer; every table of the estimates is written from these.

    Args:
        name, label: as the user spelled it, and as people read it: the name of a vector whose other two numbers are
            tied to the free one.
        initial: the scene's value, from which the fit started.
        error: the total standard deviation, of noise and systematic errors together; infinity where the picture does
            not determine the number, NaN where the error is unknown.
        standard_error, systematic_error: its part of noise alone; and of what was stated to be uncertain, and of model
            errors seen in the residual: 0 without them.
        resolution, cramer_rao: as in `Uncertainty`.
    """

    name: str
    label: str
    unit: str
    initial: float
    value: float
    error: float
    standard_error: float
    systematic_error: float
    resolution: float
    cramer_rao: float

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval, of a normal distribution with this error; a profile's is in `FitResult.profiles`."""
        half = 1.95996 * self.error  # That many standard deviations on either side hold 95 % of a normal distribution.
        return self.value - half, self.value + half

    def text(self, long: bool = False) -> str:
        """The value with its error as people write it, `1.337(2)`; `long` writes `1.337 +- 0.002`."""
        return with_error(self.value, self.error, long)

    def __str__(self) -> str:
        return self.text()


@dataclasses.dataclass(frozen=True)
class ViewPictures:
    """The pictures of a view of a fit, and how they differ.

    Args:
        target_samples: n, where each of the target's pixels was taken for the mean of n x n samples on a regular grid;
            1 is a point, None the mean over the whole pixel.
        start_image, image: the picture at the start and at the estimate, under the camera's response there; None where
            the fit was stopped before it was rendered.
        rms_residual: root mean square of image minus target over all pixels that count and channels, unblurred; NaN
            where the fit was stopped before.
        typical_residual: a robust estimate of the residuals' size: the standard deviation of a normal distribution with
            the median magnitude of the residuals that depend on a free parameter. A few outliers do not change it.
        left_out: how many pixels a robust loss counts for a hundredth or less.
    """

    settings: ResolvedSettings
    target: Image
    weights: Image
    target_samples: int | None
    start_image: Image | None = None
    image: Image | None = None
    rms_residual: float = math.nan
    typical_residual: float = math.nan
    left_out: int = 0


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class FitResult(ViewPictures):
    """The estimate, how sure it is, and how it came about; the pictures are those of the first view.

    Args:
        status: how the fit ended. `converged`: the solver came to rest, the picture is explained, and it determines
            every parameter; `ambiguous`: another minimum explains it as well; `degenerate`: some parameter or
            combination is not determined; `model_incomplete`: the residual is more than noise, so that something in the
            target is not as the scene says; `not_converged`: the solver still moved, or the picture is far from
            explained; `interrupted`: stopped by the user or a budget.
        message, advice: why, and what to do about it, in words; the latter is empty where nothing helps.
        at_bound: (name, bound) of each estimate that ran to the end of its range.
        names: the free scalar parameters, as the user spelled them.
        initial, units: of the free parameters: the scene's values, from which the fit started.
        priors: (name, mean, standard deviation) of each prior.
        ties: (follower, leader) of each tie.
        loss: the loss of the last level, `l2` or `cauchy`; the requested one where the fit did not reach that level.
        check: the fixed numbers that they depend on, and what the residual shows beside noise.
        steps: the solver's steps, in the order in which they were made.
        candidate: the start that led to the estimate, as in `FitStep`.
        runner_ups: the other minima, best first.
        further_views: the pictures of the views beside the first, in the order of the scene's cameras.
        alone: what each of several views tells alone.
        provenance: what was fitted, when and how, in words: `date`, `target_sha256`, and `seconds` up to the last step.
            From the command line also `target`, the file whose hash it is, `target_bytes`, its size, `command`, and
            `seconds_after_the_last_step`, in which the estimate was judged.
    """

    status: Status
    message: str
    advice: str
    at_bound: tuple[tuple[str, float], ...]
    names: tuple[str, ...]
    value: Values
    initial: Values
    units: tuple[str, ...]
    priors: tuple[tuple[str, float, float], ...]
    ties: tuple[tuple[str, str], ...]
    loss: str
    uncertainty: Uncertainty
    check: ModelCheck
    profiles: tuple[Profile, ...]
    scene: Scene
    steps: tuple[FitStep, ...] = ()
    candidate: int = 0
    runner_ups: tuple[Minimum, ...] = ()
    provenance: dict[str, str] = dataclasses.field(default_factory=dict)
    further_views: tuple[ViewPictures, ...] = ()
    alone: tuple[ViewAlone, ...] = ()

    def seen_by(self, camera: str) -> "FitResult":
        """The result whose pictures, and whose scene's camera, are those of one of its views.

        Raises:
            SceneError: the scene has no such camera; the message lists those that it has.
        """
        scene, place = self.scene.seen_by(camera), self.scene.cameras.index(camera)
        if not place:
            return self
        mine = {field.name: getattr(self, field.name) for field in dataclasses.fields(ViewPictures)}
        others = [ViewPictures(**mine), *self.further_views]
        pictures = others.pop(place)
        return dataclasses.replace(self, scene=scene, further_views=tuple(others), **vars(pictures))

    @property
    def views(self) -> dict[str, "FitResult"]:
        """The result as each of its cameras sees it, by the camera's name; see `seen_by`."""
        return {camera: self.seen_by(camera) for camera in self.scene.cameras}

    @property
    def counts(self) -> Mask:
        """The pixels with a weight in any channel."""
        return np.any(self.weights > 0, axis=0)

    @functools.cached_property
    def residual_pixels(self) -> int:
        """How few pixels hold nine tenths of the sum of the residual's squares; 0 where there is none."""
        if self.image is None:
            return 0
        off = np.where(self.weights > 0, self.image - self.target, 0)
        squares = np.sort(np.sum(off**2, axis=0)[self.counts])[::-1]
        total = squares.sum()
        return 1 + int(np.searchsorted(np.cumsum(squares), 0.9 * total)) if total > 0 else 0

    @property
    def standard_error(self) -> Values:
        """One standard deviation of each estimate, of noise alone."""
        return self.uncertainty.standard_error

    @property
    def systematic_error(self) -> Values:
        """One standard deviation from stated uncertainties and model errors seen in the residual; 0 without them."""
        return root_diagonal(self.check.covariance)

    @property
    def total_error(self) -> Values:
        """One standard deviation of each estimate, from noise and systematic errors together."""
        return np.hypot(self.standard_error, self.systematic_error)

    @property
    def total_correlation(self) -> Covariance:
        """The correlation matrix of the estimates, from noise and systematic errors together."""
        return correlation_of(self.uncertainty.covariance + self.check.covariance)

    @property
    def depends_on(self) -> dict[str, Dependence]:
        """For each estimate the number that counts as exact and on which it depends most; by name."""
        errors = enumerate(zip(self.names, map(float, self.total_error), strict=True))
        rests = {name: self.check.dependence(k, name, error) for k, (name, error) in errors}
        return {name: dependence for name, dependence in rests.items() if dependence}

    @property
    def rests_on(self) -> str:
        """A sentence on what the first free number depends on most; empty where there is nothing."""
        dependence = self.depends_on.get(self.names[0])
        return dependence.words if dependence else ""

    @property
    def dispersions(self) -> dict[str, Dispersion]:
        """Index at 587.56 nm and Abbe's number by name of each material whose `abbe` or three indices were free."""
        return fitted_dispersions(self.scene, self.names, self.uncertainty.covariance + self.check.covariance)

    @property
    def which_glass(self) -> list[str]:
        """A sentence for each of `dispersions` that is told, with the catalogue's names, of a fit that converged."""
        found = self.dispersions if self.status == "converged" else {}
        return [words for words in itertools.starmap(dispersion_words, found.items()) if words]

    @property
    def labels(self) -> tuple[str, ...]:
        """The names as people read them, see `Estimate`."""
        return tuple(estimate.label for estimate in self.parameters.values())

    @property
    def parameters(self) -> dict[str, Estimate]:
        """The estimates by name."""
        # A vector whose other two numbers are tied to the free one.
        stems = [name.rpartition(".")[0] for name in self.names]
        followers = [(follower.rpartition(".")[0], leader) for follower, leader in self.ties]
        tied = [followers.count((stem, name)) for name, stem in zip(self.names, stems, strict=True)]
        labels = [stem if n == 2 else name for name, stem, n in zip(self.names, stems, tied, strict=True)]
        numbers = [self.initial, self.value, self.total_error, self.standard_error, self.systematic_error]
        numbers += [self.uncertainty.resolution, self.uncertainty.cramer_rao]
        rows = zip(self.names, labels, self.units, *(column.tolist() for column in numbers), strict=True)
        return {row[0]: Estimate(*row) for row in rows}

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of a free number, as `result["glass.ior"]`: its value, its error, its unit, its interval.

        Raises:
            ParameterError: the number was not free, or there is none of that name.
        """
        estimates = self.parameters
        if name not in estimates:
            suggestion = did_you_mean(name, estimates)
            raise ParameterError(f"the fit has no free number {name}.{suggestion} Free: {listed(estimates)}.")
        return estimates[name]

    def summary(self) -> str:
        """What the command line prints: the estimates, a line each, and the last word."""
        heads, rows = estimate_table(self.parameters.values())
        return "\n".join([*aligned([heads, *rows]), last_word(self)])

    def save(self, folder: StrPath, *, long: bool = False, pdf: bool = False) -> None:
        """Write the report of a fit into a folder.

        The files are `result.json` and `fit.txt`, with the pictures of its textures, and then `result.npz`, which
        `FitResult.load` reads, `fit.exr`, `residual.exr`, the figure `report.png` and the page `report.html`. For a
        paper there are also `estimates.csv`, `estimates.tex`, and what was done as `methods.txt`. Each appears only
        when it is whole, and one of an earlier fit is replaced. `residual.exr` is signed, the fit minus the target; a
        fit that was stopped before it rendered its picture has neither of the two EXR files. Of several views each has
        both, named by its camera, as `fit_left.exr`. `report.html` needs no other file and no network. `result.json`
        has null for what is infinite or not a number.

        Args:
            folder: where to write; it is made if it is missing.
            long: whether estimates are written `1.337 +- 0.002` in place of `1.337(2)`.
            pdf: whether the figure is written as `report.pdf` as well, for a paper; that takes seconds.

        Raises:
            RaytraceError: the folder or a file in it cannot be written, or a picture holds NaN.
        """
        from ..report.fit_report.folder import write_report

        write_report(self, folder, long, pdf)

    @staticmethod
    def load(folder: StrPath) -> "FitResult":
        """The result whose report lies in a folder, number for number.

        Its scene is in float64 only with `jax_enable_x64`, if the fit's was.

        Raises:
            RaytraceError: there is no report, or it was written by another version.
        """
        return load_record(folder, FitResult)

    def __repr__(self) -> str:
        estimates = ", ".join(f"{name} {estimate}" for name, estimate in self.parameters.items())
        return f"<FitResult {self.status}: {estimates}>"

    def _repr_html_(self) -> str:
        heads, rows = estimate_table(self.parameters.values())
        table = ""
        for tag, texts in (("th", heads), *(("td", row) for row in rows)):
            table += f"<tr>{''.join(f'<{tag}>{html.escape(text)}</{tag}>' for text in texts)}</tr>"
        return f"<table>{table}</table><p>{html.escape(last_word(self))}</p>"


def estimate_table(estimates: Iterable[Estimate], long: bool = False) -> tuple[list[str], list[tuple[str, ...]]]:
    """The heads and rows of a table of the estimates: name, start, estimate with the error to publish, and its parts.

    `long` writes `1.337 +- 0.002` in place of `1.337(2)`.
    """
    # No error is shown if none is known, and its parts only if there are several.
    estimates, heads = list(estimates), ["parameter", "initial", "estimate"]
    is_known = not all(math.isnan(each.standard_error) for each in estimates)
    rows = [
        (each.label, f"{each.initial:.8g}", each.text(long) if is_known else f"{each.value:.8g}") for each in estimates
    ]
    if not (is_known and any(each.systematic_error > 0 for each in estimates)):
        return heads, rows
    parts = [
        tuple(value_and_error(0.0, error)[1] for error in (each.standard_error, each.systematic_error))
        for each in estimates
    ]
    return [*heads, "of noise", "of the model"], [row + part for row, part in zip(rows, parts, strict=True)]


def last_word(result: FitResult) -> str:
    """The fit's ending, its reason, advice, what the answer rests on, and which glass it is, a sentence each."""
    sentences = [f"{result.status}: {result.message}", as_sentence(result.advice), as_sentence(result.rests_on)]
    sentences += result.which_glass
    return " ".join(f"{words.rstrip('.')}." for words in sentences if words)


def as_sentence(words: str) -> str:
    """Words with a capital letter, unless they begin with a name."""
    return words if "." in words.partition(" ")[0] else words[:1].upper() + words[1:]
