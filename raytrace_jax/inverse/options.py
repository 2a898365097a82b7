"""What a fit can be told; free of JAX, for the command line."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, Literal, NamedTuple, get_args

from raytrace_jax.errors import ParameterError
from raytrace_jax.scene.setting_words import MAX_SAMPLES, EdgeMode
from raytrace_jax.util.words import did_you_mean, quoted

LossName = Literal["l2", "cauchy"]
"""The losses of `inverse.problem.comparison`."""

LossChoice = Literal["auto", LossName]
"""`auto`: the loss that suits how the target was sampled."""

TargetSampling = Literal["auto", "box", "point", "aware"]
"""How a target's pixels were made: `box` is the mean over each, `point` one ray, `aware` this program's edge-aware
ones, `auto` whichever of the first two is nearer to the target."""


@dataclasses.dataclass(frozen=True)
class FitOptions:
    """How a fit is set up and solved; the defaults suit the picture of a camera and that of a renderer.

    Args:
        search: whether to look for starts; if not, the scene's values are trusted to be near.
        ties: leader by follower: the follower always has the leader's value.
        priors: mean and standard deviation of Gaussian priors, by name of a free number.
        uncertain: standard deviations of numbers that stay fixed, or shares of each number's size as "0.1%"; by name of
            a number, a vector, a block (`cam1`) or a kind of blocks (`lights`).
        correlations: of numbers that are uncertain, by pairs of names: a calibrated camera's errors belong together.
        fit_exposure: whether the target is a gain times the picture plus an offset, both free and the same for all
            channels: the parameters `film.gain.r` and `film.offset.r`, which the others follow.
        sigma: standard deviation of the noise in a channel of a pixel of weight 1; estimated if it is not given.
        loss: `l2`, `cauchy`; `auto` is `cauchy` on point-sampled targets, else `l2`.
        edges: `point` fits with point-sampled pictures throughout, whose derivative misses edges.
        target_sampling: how the target's pixels were made: `box` is the mean over the pixel, as of a camera or a
            supersampling renderer, `point` one ray a pixel, `aware` this program's edge-aware picture, `auto` whichever
            of the first two is nearer to it before the last level.
        target_samples: n, where each of the target's pixels is the mean of n x n samples on a regular grid, 1 to 64;
            found out if it is not given.
        blur: standard deviations of the blurred levels in the target's pixels, coarse to fine; chosen if not given.
        profiles: free numbers whose profile likelihood is drawn.
        max_steps: steps of the solver on the last level, at most.
        max_seconds: stop (`interrupted`) after this time.

    Raises:
        ParameterError: a value outside what is said above, or of another type.
    """

    search: bool = True
    ties: Mapping[str, str] = dataclasses.field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    uncertain: Mapping[str, float | str] = dataclasses.field(default_factory=dict)
    correlations: Mapping[tuple[str, str], float] = dataclasses.field(default_factory=dict)
    fit_exposure: bool = False
    sigma: float | None = None
    loss: LossChoice = "auto"
    edges: EdgeMode = "aware"
    target_sampling: TargetSampling = "auto"
    target_samples: int | None = None
    blur: Sequence[float] | None = None
    profiles: Sequence[str] = ()
    max_steps: int = 60
    max_seconds: float | None = None

    def __post_init__(self):
        # Types come first, so that what follows can compare and count.
        check_types(self)
        for name, words in {"loss": LossChoice, "edges": EdgeMode, "target_sampling": TargetSampling}.items():
            if getattr(self, name) not in get_args(words):
                raise ParameterError(f"{name} is {getattr(self, name)!r}; wanted one of {', '.join(get_args(words))}.")
        if self.sigma is not None and not (math.isfinite(self.sigma) and self.sigma > 0):
            raise ParameterError(f"sigma is {self.sigma:g}; wanted a finite standard deviation greater than 0.")
        if self.blur is not None and not all(math.isfinite(sigma) and sigma >= 0 for sigma in self.blur):
            raise ParameterError(f"blur is {tuple(self.blur)}; wanted finite standard deviations in pixels, 0 or more.")
        if self.target_samples is not None:
            self._check_target_samples(self.target_samples)
        if self.max_steps < 1:
            raise ParameterError(f"max_steps is {self.max_steps}; wanted 1 or more.")
        if self.max_seconds is not None and not self.max_seconds > 0:
            raise ParameterError(f"max_seconds is {self.max_seconds:g}; wanted a time greater than 0.")

    def _check_target_samples(self, samples: int) -> None:
        if not 1 <= samples <= MAX_SAMPLES:
            raise ParameterError(f"target_samples is {samples}; wanted 1 to {MAX_SAMPLES}.")
        contrary = {"point": samples > 1, "box": samples == 1, "aware": True, "auto": False}[self.target_sampling]
        if contrary:
            raise ParameterError(
                f"target_samples is {samples}, which contradicts target_sampling {self.target_sampling!r}: one sample "
                "a pixel is a point, several are a box, and edge-aware pixels have none."
            )
        if self.edges == "point":
            raise ParameterError("target_samples is for edges 'aware'; with edges 'point' set samples instead.")

    @property
    def known_sampling(self) -> TargetSampling:
        """How the target was sampled, as far as that was said."""
        if self.target_samples is None:
            return self.target_sampling
        return "box" if self.target_samples > 1 else "point"

    def as_made(self, how_made: Mapping[str, Any]) -> "FitOptions":
        """These options with the sampling that the metadata of the target's file says, if nothing else was said.

        Args:
            how_made: what `render` has written into the file; empty for the files of other programs.
        """
        made = how_made.get("settings")
        if self.known_sampling != "auto" or self.edges == "point" or not isinstance(made, Mapping):
            return self
        samples, edges, binning = (made.get(name) for name in ("samples", "edges", "binning"))
        if edges == "aware" and samples == binning == 1:
            return dataclasses.replace(self, target_sampling="aware")
        if edges == "point" and isinstance(samples, int) and isinstance(binning, int):
            return dataclasses.replace(self, target_samples=samples * binning)
        return self


def changed_options(options: FitOptions, changes: Mapping[str, Any]) -> FitOptions:
    """The options with some of their fields changed.

    Raises:
        ParameterError: what was given is no `FitOptions`, or has no such field; a value that makes no sense.
    """
    names = [field.name for field in dataclasses.fields(FitOptions)]
    if not isinstance(options, FitOptions):
        raise ParameterError(
            f"options are of the type {type(options).__name__}; FitOptions are wanted, as FitOptions(sigma=0.01), or "
            "its fields as keywords of fit."
        )
    for name in changes:
        if name not in names:
            close = did_you_mean(name, names)
            raise ParameterError(f"there is no option {quoted(name)}.{close} There are {', '.join(names)}.")
    return dataclasses.replace(options, **changes)


class Wanted(NamedTuple):
    """What an option has to be.

    Args:
        holds: whether a value is that.
        words: what is wanted, in words.
    """

    holds: Callable[[object], bool]
    words: str


def is_number(value: object) -> bool:
    """Whether a value is one number, also of NumPy or JAX."""
    return (isinstance(value, Real) and not isinstance(value, bool)) or getattr(value, "shape", None) == ()


def is_whole(value: object) -> bool:
    """Whether a value is a whole number."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_row(value: object, holds: Callable[[object], bool]) -> bool:
    """Whether a value is a row, and no text, for all of whose entries something holds."""
    rows = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    return (rows or len(getattr(value, "shape", ())) == 1) and all(map(holds, value))  # type: ignore[arg-type]


def is_table(value: object, holds: Callable[[object], bool]) -> bool:
    """Whether a value is a mapping from names to values for all of which something holds."""
    return (
        isinstance(value, Mapping) and all(isinstance(name, str) for name in value) and all(map(holds, value.values()))
    )


def is_text(value: object) -> bool:
    """Whether a value is a text."""
    return isinstance(value, str)


def is_pair(value: object) -> bool:
    """Whether a value is two numbers."""
    return is_row(value, is_number) and len(value) == 2  # type: ignore[arg-type]


WANTED = {
    "ties": Wanted(lambda value: is_table(value, is_text), "the leader's name by the follower's"),
    "priors": Wanted(
        lambda value: is_table(value, is_pair),
        "(mean, standard deviation) by name, as {'glass.ior': (1.5, 0.1)}",
    ),
    "uncertain": Wanted(
        lambda value: is_table(value, lambda one: is_number(one) or is_text(one)),
        "a standard deviation, or a share as '0.1%', by name",
    ),
    "sigma": Wanted(is_number, "a number"),
    "blur": Wanted(lambda value: is_row(value, is_number), "a list of numbers"),
    "profiles": Wanted(lambda value: is_row(value, is_text), "a list of names"),
    "target_samples": Wanted(is_whole, "a whole number"),
    "max_steps": Wanted(is_whole, "a whole number"),
    "max_seconds": Wanted(is_number, "a number"),
}
"""What the options have to be, by their names; None is not checked."""


def check_types(options: object) -> None:
    """Refuse options of another type.

    Raises:
        ParameterError: an option is of another type; it says what was given and what is wanted.
    """
    for name, wanted in WANTED.items():
        value = getattr(options, name)
        if value is not None and not wanted.holds(value):
            raise ParameterError(f"{name} is {value!r}; wanted {wanted.words}.")
