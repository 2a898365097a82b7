"""The options of every command as typed dataclasses: tyro makes the parser and the help texts of them.

Nothing here imports JAX, so that `--help` answers at once.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from raytrace_jax.cli._errors import UsageError
from raytrace_jax.settings import RenderSettings

SceneFile = Annotated[Positional[Path], arg(metavar="SCENE")]
Assignments = Annotated[UseAppendAction[tuple[str, ...]], arg(name="define", aliases=["-D"], metavar="NAME=VALUE")]
Aov = Literal["depth", "normal", "position", "shape_index", "bounce_count"]
Transfer = Literal["course", "srgb"]


@dataclass(frozen=True)
class RenderOptions:
    """How a picture is made; `render`, `grad` and `fit` share these."""

    reflectance: Literal["none", "schlick"] = "schlick"
    """How reflected and transmitted light share a transparent surface. none: alpha blends the transmitted ray only;
    schlick: alpha blends both, weighted with Schlick's approximation of Fresnel's equations."""
    eta: Literal["course", "physical"] = "course"
    """The ratio of indices on leaving a shape. course: 1.000293 * ior, as the course's code has it; physical:
    ior / 1.000293. Entering is the same in both."""
    max_bounces: Annotated[int, arg(metavar="N")] = 5
    """How often a path may bounce, 0 to 64; a ray that has bounced more often is black."""
    samples: Annotated[int, arg(metavar="N")] = 1
    """Samples per pixel and side: N renders an N x N grid within each pixel and averages it. 1 to 64."""
    mapping: Literal["corner", "center"] = "corner"
    """Where the pixels look. corner: pixel x at x / (width - 1) of the image plane, end points included, as the
    course has it; center: at (x + 1/2) / width, the centres of pixels that tile the image plane."""
    size: Annotated[tuple[int, int] | None, arg(metavar="W H")] = None
    """Width and height of the picture in pixels; without it the camera's pixeldim."""
    crop: Annotated[tuple[int, int, int, int] | None, arg(metavar="X Y W H")] = None
    """Render only this window of the picture: its left and top pixel, its width and its height."""
    precision: Literal[32, 64] = 64
    """Bits of the floating-point numbers in use. 32 is faster; a fit wants 64."""
    total_internal_reflection: bool = True
    """Reflect a ray that cannot leave a shape; with --no-... it is lost (black)."""
    second_root: bool = True
    """Let rays inside of a sphere hit its far side; with --no-... they pass it unseen."""
    reflection: bool = True
    """Follow the mirror ray of the specular colour; with --no-... there is none."""

    def settings(
        self, aov: tuple[str, ...] = (), edges: Literal["point", "aware"] = "point", binning: int = 1
    ) -> RenderSettings:
        """The settings that these options mean. Raises UsageError for a value outside of its limits."""
        try:
            return RenderSettings(
                size=self.size,
                crop=self.crop,
                samples=self.samples,
                mapping=self.mapping,
                reflectance=self.reflectance,
                eta=self.eta,
                max_bounces=self.max_bounces,
                total_internal_reflection=self.total_internal_reflection,
                second_root=self.second_root,
                reflection=self.reflection,
                aov=aov,
                edges=edges,
                binning=binning,
            )
        except ValueError as reason:
            raise UsageError(f"--{str(reason).replace('max_bounces', 'max-bounces')}.") from None


@dataclass(frozen=True)
class Render:
    """Render a scene to an OpenEXR picture, with a PNG beside it, and print their paths.

    Example: raytrace-jax render vitreous.txt -o vitreous.exr -D vitreous.ior=1.5 --aov depth normal
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.exr")]
    """The picture to write: OUT.exr (and OUT.png beside it), or OUT.png alone. Missing folders are made."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the names."""
    edges: Literal["point", "aware"] = "point"
    """What a sample sees. point: one ray, as the course has it; aware: the area around it, edges blended smoothly."""
    binning: Annotated[int, arg(metavar="N")] = 1
    """Render one large pixel for each N x N of the picture: a quick preview."""
    aov: Annotated[UseAppendAction[tuple[tuple[Aov, ...], ...]], arg(metavar="NAME ...")] = ()
    """More channels for the OpenEXR file: depth, normal, position, shape_index, bounce_count."""
    half: bool = False
    """Store 16-bit floats in the OpenEXR file, half its size."""
    png: bool = True
    """Write a PNG beside the OpenEXR file."""
    png_transfer: Transfer = "course"
    """Colours in the PNG. course: floor(255 * C), no gamma; srgb: what screens expect."""
    quiet: bool = False
    """Say nothing on the way; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()


@dataclass(frozen=True)
class Grad:
    """Differentiate the picture of a scene with respect to parameters.

    OUT.exr gets the picture (R G B) and for each number a signed layer, as d.vitreous.ior.R/G/B or
    d.vitreous.center.x.R/G/B. OUT.png beside it shows them on one sheet, the mean over R, G and B. The paths of both
    are printed.

    Example: raytrace-jax grad vitreous.txt --wrt vitreous.ior vitreous.center -o derivatives.exr --check
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    wrt: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(metavar="NAME ...")]
    """The parameters (required), as vitreous.ior or vitreous.center; `raytrace-jax info SCENE` lists all."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.exr")]
    """The OpenEXR file to write, with OUT.png beside it. Missing folders are made."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the names."""
    edges: Literal["aware", "point"] = "aware"
    """aware: derivatives see silhouettes and refracted edges move; point: they do not.
    Derivatives that miss edges are faster and of little use."""
    check: bool = False
    """Compare with finite differences of supersampled pictures: a second row on the sheet, and a table on stdout."""
    check_samples: Annotated[int, arg(metavar="N")] = 16
    """The pictures for --check, two for each number, have N x N rays a pixel. 1 to 64."""
    check_step: Annotated[float, arg(metavar="X")] = 0.006
    """How far --check moves a parameter to either side, in its own unit; less where its limits are near."""
    quiet: bool = False
    """Say nothing on the way; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()


@dataclass(frozen=True)
class Fit:
    """Fit parameters of a scene to a picture, and say how sure they are.

    The search for starts begins at SCENE with its -D values. The folder gets result.json, report.html and report.png,
    the fitted scene fit.txt, its picture fit.exr and residual.exr, fit minus target. The last line says how it ended:
    converged, ambiguous, degenerate, not_converged or interrupted; the exit code is 3 for all but the first.
    Ctrl-C stops it and still writes what there is; --resume goes on from there, or after a kill.

    Example: raytrace-jax fit guess.txt photo.exr --free vitreous.ior vitreous.center -o result
    """

    scene: SceneFile
    """The scene to start from, a model.txt file."""
    target: Annotated[Positional[Path], arg(metavar="TARGET")]
    """The picture to explain, OpenEXR or PNG, of the size that is rendered."""
    free: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(metavar="NAME ...")]
    """The parameters to find (required), as vitreous.ior or vitreous.center; `raytrace-jax info SCENE` lists all."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """The folder for the results; it is made if it is missing."""
    assignments: Assignments = ()
    """Set a parameter before the search, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1."""
    search: bool = True
    """Scan indices and positions for starts; with --no-search the scene's values are trusted to be near."""
    tie: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=FREE")] = ()
    """Let a parameter follow a free one, as cyan.ior=vitreous.ior or small.center=large.center."""
    prior: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=MEAN+-SD")] = ()
    """What is known of a free number, as vitreous.radius=2.3+-0.01: mean and standard deviation."""
    fit_exposure: bool = False
    """Fit the target's exposure and offset as well: target = exposure * picture + offset."""
    mask: Annotated[Path | None, arg(metavar="FILE")] = None
    """Weights of the target's pixels, an OpenEXR or PNG picture: 0 leaves a pixel out, 1 counts in full."""
    sigma: Annotated[float | None, arg(metavar="SD")] = None
    """Standard deviation of the target's noise, where colours reach from 0 to 1; estimated if it is not given."""
    loss: Literal["auto", "l2", "huber", "cauchy"] = "auto"
    """What large residuals count. l2: their squares; huber, cauchy: less, for outliers and for what the scene lacks;
    auto: cauchy for a point-sampled target, else l2."""
    profile: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(metavar="NAME ...")] = ()
    """Draw the profile likelihood of these numbers: hold one at values around its estimate, fit the others again."""
    edges: Literal["aware", "point"] = "aware"
    """aware: derivatives see silhouettes and refracted edges move; point: they do not, which often fails."""
    target_sampling: Literal["auto", "box", "point"] = "auto"
    """How the target's pixels were made. box: the mean over the pixel, as of a camera or many samples; point: one ray
    a pixel; auto: whichever is nearer to the target before the last level."""
    transfer: Transfer = "course"
    """How the colours of a PNG target were stored. course: floor(255 * C), no gamma; srgb: as screens expect."""
    layer: Annotated[str | None, arg(metavar="NAME")] = None
    """Which layer of an OpenEXR target, when it is not obvious."""
    blur: Annotated[tuple[float, ...] | None, arg(metavar="SIGMA ...")] = None
    """Standard deviations in pixels of the blurred levels, coarse to fine; without it they are chosen."""
    max_steps: Annotated[int, arg(metavar="N")] = 60
    """The most steps of the solver on the last level."""
    max_seconds: Annotated[float | None, arg(metavar="SECONDS")] = None
    """Stop after this time and write what there is; without it there is no limit."""
    resume: bool = False
    """Go on with the fit that was interrupted in DIR; it ends as it would have."""
    quiet: bool = False
    """Show no progress; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()


@dataclass(frozen=True)
class Format:
    """Write a scene file in canonical form, with the same numbers.

    Example: raytrace-jax format vitreous.txt -D vitreous.radius=2 > smaller.txt
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1."""


@dataclass(frozen=True)
class Info:
    """List the blocks of a scene and its parameters, by the names that -D and --free take.

    Example: raytrace-jax info vitreous.txt
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1."""
