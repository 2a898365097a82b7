"""The command `fit`: from a picture, whose file may not say how its colours were stored, to parameters."""

import dataclasses
import hashlib
import shlex
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...errors import PictureError
from ...images import Transfer, exif, jpeg, masks, pictures
from ...images.transfer import DECODERS, ENCODERS, Colours
from ...inverse.build_problem import as_file_says, asked_for, build_problem, of_each_view
from ...inverse.estimate import fit
from ...inverse.problem.sampling import supersampled
from ...inverse.result import estimate_table, last_word
from ...inverse.result_file import save_record
from ...report.fit_report.summary import AFTER, write_numbers
from ...scene.bundled import scene_path
from ...scene.parameters import parse_assignment, set_parameters
from ...scene.scene import PerspectiveCamera, Scene
from ...scene.structs import USUAL_FOV
from ...tracer.pixels import refuse_too_large
from ...tracer.settings import ResolvedSettings
from ...util.background import Clock, run_beside
from ...util.numerics import TINY
from ..console import TYPED, UsageError, print_table, print_warning, stderr_console
from ..options.fits import Fit, TargetFile
from ..preparation import check_folder, read_picture_scene, warn_of_shared_materials
from ..progress import FitProgress, Timer


def read_targets(
    command: Fit, files: Mapping[str, TargetFile], scene: Scene, settings: Mapping[str, ResolvedSettings]
) -> dict[str, dict[str, Any]]:
    """Read the target of each camera: what `fit` takes, by its words for it; weights and storage may be None.

    What of it counts nothing, or was not clear, is said on stderr.
    """
    targets, weights, storage = {}, {}, {}
    for name, file in files.items():
        view, how = scene.seen_by(name), settings[name]
        weights[name] = None if file.mask is None else seen_part(masks.read_mask(file.mask), view, how, "the mask")
        targets[name] = read_colours(file, view, how, file.transfer)
    targets |= unclear_colours(command, files, scene, settings, targets, weights)
    for name, file in files.items():
        path, view, how = file.path, scene.seen_by(name), settings[name]
        clipped = masks.clipped_pixels(path, targets[name], command.clipped, clamps=how.model != "physical")
        if words := clipped.words(path):
            print_warning(words)
            weights[name] = clipped.weights * (1 if weights[name] is None else weights[name])
            if not np.any(weights[name]):
                raise PictureError(f"{path}: no pixel is left that counts; --clipped keep counts the clipped ones")
        stored = jpeg.jpeg_storage(path, file.transfer or "srgb") if pictures.is_jpeg(path) else None
        storage[name] = stored and stored._replace(window=seen_window(stored.size, view, how, "the target"))
    return {"target": targets, "weights": weights, "storage": storage}


def seen_part(
    picture: Float[np.ndarray, "*any height width"], scene: Scene, settings: ResolvedSettings, what: str
) -> Float[np.ndarray, "*any rows columns"]:
    height, width = picture.shape[-2:]
    left, top, columns, rows = seen_window((width, height), scene, settings, what)
    return picture[..., top : top + rows, left : left + columns]


def seen_window(
    size: tuple[int, int], scene: Scene, settings: ResolvedSettings, what: str
) -> tuple[int, int, int, int]:
    """The window (x, y, width, height) of a picture that is rendered: the crop's place in a whole one, all of a crop.

    Raises:
        PictureError: the picture is neither as large as the whole one nor as the crop.
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
    if not isinstance(camera, PerspectiveCamera) or not pictures.is_photograph(path):
        return scene
    told, has = exif.angle_of_view(path), float(camera.fov)
    # Nobody is told of a difference up to 2 %, for lenses are named in round millimetres.
    if told is None or abs(told - has) <= 0.02 * has:
        return scene
    name = f"{camera.name}.fov"
    is_set = any(parse_assignment(text)[0] == name for text in assignments)
    if is_set or has != np.asarray(USUAL_FOV, camera.fov.dtype):
        print_warning(f"{path} tells an angle of view of {told:.4g} degrees; {name} is {has:.4g}, which holds.")
        return scene
    print_warning(f"{path} tells an angle of view of {told:.4g} degrees: {name} begins there.")
    return set_parameters(scene, {name: told})


def read_colours(file: TargetFile, scene: Scene, settings: ResolvedSettings, transfer: Transfer | None) -> Colours:
    """The part of a target that is rendered; where neither file nor user says its transfer, as the course stores it."""
    if transfer is None and not pictures.states_colours(file.path):
        transfer = "course"
    return seen_part(
        pictures.read_picture(file.path, transfer=transfer, layer=file.layer), scene, settings, "the target"
    )


def unclear_colours(
    command: Fit,
    files: Mapping[str, TargetFile],
    scene: Scene,
    settings: Mapping[str, ResolvedSettings],
    targets: Mapping[str, Colours],
    weights: Mapping[str, Any],
) -> dict[str, Colours]:
    """The targets of which neither file nor user says how they were stored, and say on stderr how they were read.

    They are compared with the pictures at the start, in the pixels that count.
    """
    unclear = [name for name, file in files.items() if not (file.transfer or pictures.states_colours(file.path))]
    if not unclear:
        return {}
    built = build_problem(scene, targets, command.free, settings, command.fit_options(), weights)
    found = {}
    for view in built.problem.views:
        name = view.scene.camera.name
        if name not in unclear:
            continue
        # Beside, as a fit is: Ctrl-C need not wait for what is compiled here.
        image = run_beside(lambda view=view: supersampled(view, view.start(), view.base.samples), Clock())
        counts, file = view.observation.counts, files[name]
        off = stored_differences(image[:, counts], targets[name][:, counts], bool(view.camera.linear_indices))
        nearest = min(off, key=lambda transfer: off[transfer])
        # The course's transfer holds unless another one is clearly nearer.
        is_clear = off[nearest] < 0.7 * off["course"]
        taken = nearest if is_clear else "course"
        others = ", ".join(f"--transfer {name}: {value:.2g}" for name, value in off.items() if name != taken)
        why = "whose numbers are nearer to the picture at the start" if is_clear else "as no other is clearly nearer"
        print_warning(
            f"{file.path} does not say how its colours were stored: read with --transfer {taken}, {why} "
            f"(off by {off[taken]:.2g}; with {others}); --transfer decides."
        )
        if is_clear:
            found[name] = read_colours(file, scene.seen_by(name), settings[name], taken)
    return found


def stored_differences(
    image: Float[np.ndarray, "3 pixels"], target: Float[np.ndarray, "3 pixels"], gains_are_free: bool
) -> dict[Transfer, float]:
    """The mean difference of the numbers that a picture would be stored as and the target's, by transfer.

    The target is as the course's transfer reads it, which hardly changes the numbers. Where gains are free, each
    channel of the picture may be brighter or darker.
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


NOT_CONVERGED = 3  # The exit code.


def run_fit(command: Fit) -> int:
    """Fit the free parameters, print the estimates, write the report; 3 if the fit did not converge."""
    free, options = command.free, command.fit_options()
    if not free:
        raise UsageError("--free NAME ... is missing: which parameters should be found?")
    if command.pdf and not command.report:
        raise UsageError("--pdf is a figure of the report, which --no-report leaves out.")
    check_folder(command.output)
    scene, settings = read_picture_scene(command, all_cameras=True)
    scene = scene if command.camera is None else scene.alone()
    files = of_each_view(scene, "a picture", command.files(scene.cameras))
    for name, file in files.items():
        scene = with_angle_of_view(scene.seen_by(name), file.path, command.assignments).seen_by(scene.camera.name)
    filmed, names, _ = asked_for(scene, free, options)
    each_settings = {name: sized(settings, scene.seen_by(name), file) for name, file in files.items()}
    for name, how in each_settings.items():
        refuse_too_large(scene.seen_by(name), how, len(names))
    paths = [file.path for file in files.values()]
    options = as_file_says(options, paths, scene, free)
    warn_of_shared_materials(filmed, free)
    known = read_targets(command, files, scene, each_settings)

    console = stderr_console(command.quiet)
    with FitProgress(names, console, command.verbose) as show:
        result = fit(
            scene, free=free, settings=each_settings, options=options, **known, on_step=show.step, on_phase=show.phase
        )
    after = {AFTER: f"{time.monotonic() - show.stepped_at:.3g}"}
    result = dataclasses.replace(result, provenance=result.provenance | provenance(paths) | after)

    # Numbers go out before the report, which takes longer and more room on the disk.
    if not command.json:
        if result.steps:
            print_table("estimates", *estimate_table(result.parameters.values(), command.long))
        print(last_word(result))
    comments = scene_path(command.scene).read_text(encoding="utf-8-sig")
    numbers = write_numbers(result, command.output, comments)
    print(numbers if command.json else command.output, end="" if command.json else "\n", flush=True)
    if not command.report:
        save_record(result, command.output)
    elif result.status != "interrupted":
        with Timer("writing the report", console) as timer:
            # It imports matplotlib, which takes half a second that the numbers need not wait for.
            from ...report.fit_report.folder import write_pictures

            write_pictures(result, command.output, command.long, command.pdf)
            timer.took("writing the report")
    return 0 if result.status == "converged" else NOT_CONVERGED


def sized(settings: ResolvedSettings, scene: Scene, file: TargetFile) -> ResolvedSettings:
    """The settings of a camera's picture: of several cameras it is as large as its target, if --size says nothing.

    A target of other proportions, or of which a part is rendered, changes nothing.
    """
    if not scene.further_views or settings.size or settings.crop:
        return settings
    height, width = pictures.read_picture(file.path, transfer="course", layer=file.layer).shape[-2:]
    size, pixeldim = (width * settings.binning, height * settings.binning), scene.camera.pixeldim
    same = abs(size[0] * pixeldim[1] - size[1] * pixeldim[0]) < max(pixeldim)
    return dataclasses.replace(settings, size=size) if same else settings


def provenance(targets: Sequence[Path]) -> dict[str, str]:
    """Where targets come from: their paths, sizes and the hash of all, and the command that was typed."""
    contents = [target.read_bytes() for target in targets]
    return {
        "target": ", ".join(map(str, targets)),
        "target_bytes": ", ".join(str(len(content)) for content in contents),
        "target_sha256": hashlib.sha256(b"".join(contents)).hexdigest(),
        "command": shlex.join(["raytrace-jax", *TYPED.get()]),
    }
