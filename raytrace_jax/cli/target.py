"""The target of a fit: a picture whose file may not say how its colours were stored."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.cli.console import print_warning
from raytrace_jax.cli.options.fits import Fit
from raytrace_jax.errors import PictureError
from raytrace_jax.images.exif import angle_of_view
from raytrace_jax.images.jpeg import JpegStorage, jpeg_storage
from raytrace_jax.images.masks import clipped_pixels, read_mask
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.pictures import is_jpeg, is_photograph, read_picture, states_colours
from raytrace_jax.images.transfer import DECODERS, ENCODERS
from raytrace_jax.inverse.build_problem import build_problem
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.sampling import supersampled
from raytrace_jax.scene.parameters import parse_assignment, set_parameters
from raytrace_jax.scene.scene import PerspectiveCamera, Scene
from raytrace_jax.scene.table import USUAL_FOV
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.beside import run_beside
from raytrace_jax.util.numerics import TINY


class Observed(NamedTuple):
    """A target, what its pixels count, None where they count alike, and how it was compressed, if it was."""

    target: Float[np.ndarray, "3 height width"]
    weights: Float[np.ndarray, "height width"] | None
    storage: JpegStorage | None


def read_observed(
    command: Fit, scene: Scene, free: Sequence[str], settings: ResolvedSettings, options: FitOptions
) -> Observed:
    """Read the target and its mask, and say on stderr what of them counts nothing.

    Raises:
        PictureError: one of them cannot be read, or is none for this scene.
    """
    weights = None
    if command.mask is not None:
        weights = seen_part(read_mask(command.mask), scene, settings, "the mask")
    target = read_target(command, scene, free, settings, options, weights)
    clipped = clipped_pixels(command.target, target, command.clipped, clamps=settings.model != "physical")
    words = clipped.words(command.target)
    if words:
        print_warning(words)
        weights = clipped.weights if weights is None else weights * clipped.weights
        if not np.any(weights):
            raise PictureError(
                f"{command.target}: no pixel is left that counts; --clipped keep counts the clipped ones"
            )
    storage = jpeg_storage(command.target, command.transfer or "srgb") if is_jpeg(command.target) else None
    if storage is not None:
        storage = storage._replace(window=seen_window(storage.size, scene, settings, "the target"))
    return Observed(target, weights, storage)


def seen_part(
    picture: Float[np.ndarray, "*any height width"], scene: Scene, settings: ResolvedSettings, what: str
) -> Float[np.ndarray, "*any rows columns"]:
    """The part of a picture that is rendered, as `seen_window` has it. Raises PictureError as that."""
    height, width = picture.shape[-2:]
    left, top, columns, rows = seen_window((width, height), scene, settings, what)
    return picture[..., top : top + rows, left : left + columns]


def seen_window(
    size: tuple[int, int], scene: Scene, settings: ResolvedSettings, what: str
) -> tuple[int, int, int, int]:
    """The window (x, y, width, height) of a picture that is rendered: the crop's place in a whole one, all of a crop.

    Args:
        size: (width, height) of the target, or of its mask.

    Raises:
        PictureError: it is neither as large as the whole picture nor as the crop.
    """
    left, top, width, height = settings.window(scene.camera.pixeldim)
    whole = tuple(max(1, side // settings.binning) for side in settings.picture_size(scene.camera.pixeldim))
    if size == whole:
        return left, top, width, height
    if size == (width, height):
        return 0, 0, width, height
    wanted = "{} x {}".format(*whole) + ("" if settings.crop is None else f", or that of the crop, {width} x {height}")
    # A mask follows its target, which may be a whole picture of another size.
    how = f": if it shows all of that, say --size {size[0]} {size[1]}" if what == "the target" else ""
    raise PictureError(
        f"{what} is {size[0]} x {size[1]} pixels; wanted is the size of the whole picture, {wanted}{how}"
    )


def with_angle_of_view(scene: Scene, path: Path, assignments: Sequence[str]) -> Scene:
    """The scene with the angle of view that a photograph tells, if the scene does not state one; told on stderr."""
    camera = scene.camera
    if not isinstance(camera, PerspectiveCamera) or not is_photograph(path):
        return scene
    told, has = angle_of_view(path), float(camera.fov)
    name = f"{camera.name}.fov"
    is_set = any(parse_assignment(text)[0] == name for text in assignments)
    # Nobody is told of a difference up to 2 %, for lenses are named in round millimetres.
    if told is None or abs(told - has) <= 0.02 * has:
        return scene
    if is_set or has != np.asarray(USUAL_FOV, camera.fov.dtype):
        print_warning(f"{path} tells an angle of view of {told:.4g} degrees; {name} is {has:.4g}, which holds.")
        return scene
    print_warning(f"{path} tells an angle of view of {told:.4g} degrees: {name} begins there.")
    return set_parameters(scene, {name: told})


def read_target(
    command: Fit,
    scene: Scene,
    free: Sequence[str],
    settings: ResolvedSettings,
    options: FitOptions,
    weights: Float[np.ndarray, "height width"] | None,
) -> Float[np.ndarray, "3 height width"]:
    """Read the target, "3 height width", and say on stderr how it was read if neither file nor user says it.

    Args:
        command: has the file, the layer and the transfer.
        scene, free, settings, options, weights: what the picture at the start is made from.

    Raises:
        PictureError: the target cannot be read, or is none for this scene.
    """

    def read(transfer: Transfer | None) -> Float[np.ndarray, "3 height width"]:
        picture = read_picture(command.target, transfer=transfer, layer=command.layer)
        return seen_part(picture, scene, settings, "the target")

    if command.transfer is not None or states_colours(command.target):
        return read(command.transfer)
    target = read("course")
    problem = build_problem(scene, target, free, settings, options, weights).problem
    # Beside, as a fit is: Ctrl-C need not wait for what is compiled here.
    image = run_beside(lambda: supersampled(problem, problem.start(), settings.samples), lambda: None, lambda: None)
    counts = np.asarray(problem.observation.root_weight) > 0
    off = stored_differences(image[:, counts], target[:, counts], bool(problem.linear_places))
    nearest = min(off, key=lambda transfer: off[transfer])
    # The course's transfer holds unless another one is clearly nearer.
    is_clear = off[nearest] < 0.7 * off["course"]
    taken = nearest if is_clear else "course"
    others = ", ".join(f"--transfer {name}: {value:.2g}" for name, value in off.items() if name != taken)
    why = "whose numbers are nearer to the picture at the start" if is_clear else "as no other is clearly nearer"
    print_warning(
        f"{command.target} does not say how its colours were stored: read with --transfer {taken}, {why} "
        f"(off by {off[taken]:.2g}; with {others}); --transfer decides."
    )
    return read(taken) if is_clear else target


def stored_differences(
    image: Float[np.ndarray, "3 pixels"], target: Float[np.ndarray, "3 pixels"], gains_are_free: bool
) -> dict[Transfer, float]:
    """The mean difference of the numbers that a picture would be stored as and the target's, by transfer.

    Args:
        image: scene-linear.
        target: as the course's transfer reads it, which hardly changes the numbers: others are undone.
        gains_are_free: whether each channel of the picture may be brighter or darker.
    """
    stored = ENCODERS["course"](target, bits=16)
    found: dict[Transfer, float] = {}
    for name, decode in DECODERS.items():
        linear = decode(stored)
        best = np.sum(image * linear, axis=1) / np.maximum(np.sum(image**2, axis=1), TINY)
        scale = best[:, None] if gains_are_free else 1.0
        off = ENCODERS[name](scale * image, bits=16).astype(float) - stored
        found[name] = float(np.mean(np.abs(off))) / (2**16 - 1)
    return found
