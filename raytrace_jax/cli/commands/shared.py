"""Options that several commands have."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from raytrace_jax.cli.errors import UsageError
from raytrace_jax.scene.schema import ModelName
from raytrace_jax.tracer.settings import RenderSettings

SceneFile = Annotated[Positional[Path], arg(metavar="SCENE")]
Assignments = Annotated[UseAppendAction[tuple[str, ...]], arg(name="define", aliases=["-D"], metavar="NAME=VALUE")]
Transfer = Literal["course", "srgb"]


@dataclass(frozen=True)
class RenderOptions:
    """How a picture is made; `render`, `grad`, `rays` and `fit` share these."""

    """How a picture is made; `render`, `grad`, `fit` and `sweep` share these."""

    model: ModelName = "classic"
    """What a surface does with light, and the defaults of what the scene's file leaves out. classic: the assignment's
    model; additive: that of the report on checkpoints 4 to 6, with shadows."""
    reflectance: Literal["none", "schlick"] = "schlick"
    """How reflected and transmitted light share a transparent surface. none: alpha blends the transmitted ray only;
    schlick: alpha blends both, weighted with Schlick's approximation of Fresnel's equations."""
    eta: Literal["course", "physical"] = "course"
    """The ratio of indices on leaving a shape. course: 1.000293 * ior, as the course's code has it; physical:
    ior / 1.000293. Entering is the same in both."""
    max_bounces: Annotated[int | None, arg(metavar="N")] = None
    """How often a path may bounce, 0 to 64; a ray that has bounced more often is black. Without it 5, in the additive
    model 2."""
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
                model=self.model,
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
