"""The options of a fit, and the choices of one of its stages; free of JAX, for the command line."""

import dataclasses
from collections.abc import Mapping, Sequence
from math import inf
from typing import Annotated, Any, Literal

from ..errors import ParameterError
from ..scene.setting_words import MAX_SAMPLES, EdgeMode
from ..util.checked import Checked, Wanted, listed_in_help

LossName = Literal["l2", "cauchy"]
"""The losses of `inverse.problem.linearize`."""

LossChoice = Literal["auto", LossName]
"""`auto`: the loss that suits how the target was sampled."""

TargetSampling = Literal["auto", "box", "point", "aware"]
"""Sampling of a target's pixels: `box` is the mean over each, `point` one ray, `aware` this program's edge-aware
ones, `auto` whichever of the first two is nearer to the target."""


@dataclasses.dataclass(frozen=True)
class Stage:
    """The choices of one stage: how picture and target are compared.

    Args:
        blur: standard deviation of the Gaussian blur of their difference, in pixels of the target.
        binning: how many pixels are averaged to one in each direction, in picture and target.
        loss_scale: infinity with `l2`.
        noise: standard deviation of the residuals beside which priors count.
    """

    edges: EdgeMode
    blur: float = 0.0
    binning: int = 1
    loss: LossName = "l2"
    loss_scale: float = inf
    noise: float = 0.0


@listed_in_help
@dataclasses.dataclass(frozen=True, kw_only=True)
class FitOptions(Checked):
    """The setup of a fit and its solve; the defaults suit the picture of a camera and that of a renderer.

    Raises:
        ParameterError: a value outside what is said below, or of another type.
    """

    search: bool = True
    """Scan indices and positions for starts; else the scene's values are trusted to be near."""
    ties: Annotated[Mapping[str, str], Wanted("the leader's name by the follower's")] = dataclasses.field(
        default_factory=dict
    )
    """Let a parameter follow a free one, as cyan.ior=vitreous.ior or small.center=large.center."""
    priors: Annotated[
        Mapping[str, tuple[float, Annotated[float, Wanted(above=0)]]],
        Wanted("(mean, standard deviation) by name, as {'glass.ior': (1.5, 0.1)}, the latter above 0"),
    ] = dataclasses.field(default_factory=dict)
    """What is known of a free number, as vitreous.radius=2.3+-0.01: mean and standard deviation."""
    uncertain: Annotated[Mapping[str, float | str], Wanted("a standard deviation, or a share as '0.1%', by name")] = (
        dataclasses.field(default_factory=dict)
    )
    """Standard deviation of a number that stays fixed, as vitreous.radius=0.002 or vitreous.radius=0.1%. The name of a
    block (cam1=0.1%) or of a kind of blocks (lights=1%) stands for all its numbers. The errors then include it."""
    correlations: Annotated[Mapping[tuple[str, str], float], Wanted("a number by pairs of names")] = dataclasses.field(
        default_factory=dict
    )
    """Correlations of numbers that are uncertain: a calibrated camera's errors belong together."""
    fit_exposure: bool = False
    """Fit the target's exposure and offset as well: target = gain * picture + offset, the same for all channels."""
    sigma: Annotated[float | None, Wanted("a finite standard deviation greater than 0", "SD", above=0, below=inf)] = (
        None
    )
    """Standard deviation of the target's noise, where colours reach from 0 to 1; estimated if it is not given."""
    loss: LossChoice = "auto"
    """How much large residuals count. l2: their squares; cauchy: less, for outliers and objects that the scene lacks;
    auto: cauchy for a point-sampled target, else l2."""
    edges: EdgeMode = "aware"
    """aware: derivatives include the motion of silhouettes and refracted edges; point: they do not, and the fit often
    fails."""
    target_sampling: TargetSampling = "auto"
    """How the target's pixels were made. box: the mean over the pixel, as of a camera or many samples; point: one ray
    a pixel; aware: as render's with --edges aware; auto: what a file of render's says, else whichever of the first two
    is nearer to the target before the last level."""
    target_samples: Annotated[int | None, Wanted(metavar="N", least=1, most=MAX_SAMPLES)] = None
    """The target's pixels are means of N x N samples on a regular grid; without this the fit finds out N."""
    blur: Annotated[
        Sequence[float] | None,
        Wanted("finite standard deviations in pixels, 0 or more", "SIGMA ...", least=0, below=inf),
    ] = None
    """Standard deviations in pixels of the blurred levels, coarse to fine; without it they are chosen."""
    profiles: Annotated[Sequence[str], Wanted("a list of names")] = ()
    """Draw the profile likelihood of these numbers: hold one at values around its estimate, fit the others again."""
    max_steps: Annotated[int, Wanted(metavar="N", least=1)] = 60
    """The most steps of the solver on the last level."""
    max_seconds: Annotated[float | None, Wanted("a time greater than 0", "SECONDS", above=0)] = None
    """Stop after this time and write what there is; without it there is no limit."""

    def __post_init__(self):
        super().__post_init__()
        samples = self.target_samples
        if samples is None:
            return
        if {"point": samples > 1, "box": samples == 1, "aware": True, "auto": False}[self.target_sampling]:
            raise ParameterError(
                f"target_samples is {samples}, which contradicts target_sampling {self.target_sampling!r}: one sample "
                "a pixel is a point, several are a box, and edge-aware pixels have none."
            )
        if self.edges == "point":
            raise ParameterError("target_samples is for edges 'aware'; with edges 'point' set samples instead.")

    @property
    def known_sampling(self) -> TargetSampling:
        """The target's sampling as the options state it."""
        if self.target_samples is None:
            return self.target_sampling
        return "box" if self.target_samples > 1 else "point"

    @property
    def last_stage(self) -> Stage:
        """The stage on the whole picture, of a target whose sampling is known."""
        is_point = self.known_sampling == "point"
        suited: LossName = "cauchy" if is_point else "l2"
        loss = suited if self.loss == "auto" else self.loss
        return Stage("point" if is_point else self.edges, loss=loss)

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
