"""`calibrate` and `photo`: from pictures of a board to a lens, and from photographs of a ball or a tank to an index."""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from ...errors import PictureError
from ...images.exif import angle_of_view
from ...images.pictures import is_photograph
from ...inverse.estimate import fit
from ...inverse.judge.model_check import Contradiction
from ...inverse.result import estimate_table, last_word
from ...optics.dispersion import dispersion
from ...photo.boards import CharucoBoard, read_board
from ...photo.bundle import Measured
from ...photo.find_camera import calibrate
from ...photo.flattened import Flattened, flatten
from ...photo.lens import Turn, read_lens, uncalibrated, write_lens
from ...photo.locate import Located, Together, locate_together
from ...photo.opinions import AGREE, budget, combine, contradictions, shown, together_to_dict
from ...photo.outline import Disc
from ...photo.photograph import Photograph
from ...photo.room_scene import light_options, room_scene, tank_scene, wedge_comment
from ...photo.turned import turned_alike
from ...report.fit_report.folder import write_pictures
from ...report.fit_report.summary import write_numbers
from ...report.panels import save_figure
from ...report.photo_sheet import draw_photo_sheet, draw_refused
from ...scene.parameters import scalar_names
from ...scene.writer import save_scene
from ...tracer.settings import RenderSettings
from ...util.digits import with_error
from ...util.files import json_text, write_text
from ..console import UsageError, print_table, print_warning, stderr_console
from ..options.fits import Calibrate, Photo
from ..preparation import check_file, check_folder
from ..progress import FitProgress, Timer
from .fit import NOT_CONVERGED, provenance
from .photo_colours import colours_to_dict, measure_colours, print_colours, wavelengths_of
from .photo_input import measured_of, photographs_in, warn_of_unmeasured


def run_calibrate(command: Calibrate) -> int:
    """Find the lens, write it and print its numbers."""
    check_file(command.output)
    console = stderr_console(command.quiet)
    with Timer("calibrating", console) as timer:
        board = read_board(command.board)
        taken = [photograph for _, photograph in photographs_in(command.photos, command.transfer, board)]
        found = calibrate(turned_alike(taken, board), board)
        timer.took("calibrating")
    comment = f"A lens by raytrace-jax calibrate, from {len(found.names)} pictures of {command.board.name}."
    write_lens(command.output, found.lens, found.size, comment)
    estimates = [with_error(*one) for one in zip(found.lens.mean, found.lens.errors, strict=True)]
    words = ("angle of view", "k1", "k2", "principal point, right of the middle", "below the middle")
    print_table("lens", ("number", "estimate"), list(zip(words, estimates, strict=True)))
    each = [
        (Path(name).name, with_error(lens.mean[0], lens.errors[0]), f"{sigma:.3f}")
        for name, lens, sigma in zip(found.names, found.each, found.sigma, strict=True)
    ]
    print_table("each picture alone", ("picture", "angle of view", "scatter [px]"), each)
    print(command.output)
    return 0


def run_photo(command: Photo) -> int:
    """Find cameras, ball or tank, and index; write sheets, numbers and scenes, with --fit also a fit's report."""
    if not command.photos:
        raise UsageError("PHOTO: no photograph came, and one or several are wanted.")
    measured, wavelengths = measured_of(command), wavelengths_of(command.wavelengths)
    _check_options(command)
    console, folder = stderr_console(command.quiet), command.output
    check_folder(folder)
    with Timer("corners", console) as timer:
        board = read_board(command.board)
        images, photographs = zip(*photographs_in(command.photos, command.transfer, board), strict=True)
        together = _locate(command, photographs, board, measured)
        files = [folder / f"located{end}.png" for end in _ends(command.photos)]
        for file, image, result in zip(files, images, together.photographs, strict=True):
            if result.reason:
                save_figure(file, draw_refused(image, result))
        if together.adjusted is None:
            (folder / "located.json").unlink(missing_ok=True)  # Numbers of earlier photographs are not theirs.
            refused = sorted(together.photographs, key=lambda result: result.is_bare)
            raise PictureError("\n".join(result.reason for result in refused))
        light, without_light = list[Flattened | None](), list[PictureError]()
        for image, result in zip(images, together.photographs, strict=True):
            flat = None
            if result.located and not command.tank:
                # The corners need no light.
                try:
                    flat = flatten(image, result.located)
                except PictureError as reason:
                    without_light.append(reason)
            light.append(flat)
        timer.took("corners")
        colours = measure_colours(command.photos, images, together) if len(wavelengths) == 3 else None
        total = dispersion(*colours.indices(together.located[0].ior), wavelengths) if colours else None
    for file, result in zip(files, together.photographs, strict=True):
        if result.reason and (result.discs or not result.is_bare):
            left = "tells of the lens alone" if result.is_bare else "is left out"
            print_warning(f"{result.reason} It {left}: see {file}.")
    otherwise = contradictions(together.adjusted)
    code = NOT_CONVERGED if otherwise else 0
    if otherwise:
        print_warning(_in_words(otherwise, len(files) > 1, folder))
    made = [provenance([path]) for path in command.photos]
    numbers = together_to_dict(together) | {"provenance": made if len(made) > 1 else made[0]}
    for file, image, result, flat in zip(files, images, together.photographs, light, strict=True):
        if result.located:
            save_figure(file, draw_photo_sheet(image, result.located, flat, command.long, otherwise))
    if colours and total:
        numbers["colours"] = colours_to_dict(colours, total, wavelengths)
    write_text(folder / "located.json", json_text(numbers))
    if not command.json:
        print_located(together, command.long)
        if colours and total:
            print_colours(colours, total, bool(command.tank), command.long)
        elif len(wavelengths) == 1:
            print(f"The index is that at {wavelengths[0][0]:g} nm.")
        else:
            print("The photographs show no colours apart: the index is that of their mean wavelength.")
    for reason in without_light:
        if command.fit and not any(light):
            raise reason
        print_warning(f"{reason} There is no scene for a fit.")
    for end, result, flat in zip(_ends(command.photos), together.photographs, light, strict=True):
        file = folder / f"scene{end}.txt"
        if result.located and command.tank:
            save_scene(tank_scene(result.located), file, model="physical", comments=wedge_comment(result.located))
        elif result.located and flat:
            own = np.eye(len(result.located.covariance))
            room = room_scene([result.located], [flat], [own], result.located.covariance)
            save_scene(room.scene, file, model="physical")
    if command.fit:
        return max(code, _fit_light(command, together, light, console))
    print(json_text(numbers) if command.json else folder, end="" if command.json else "\n")
    return code


def _check_options(command: Photo) -> None:
    """Refuse options that do not go together. Raises UsageError."""
    for option, is_given in (("--ball", command.ball), ("--fit", command.fit), ("--in", command.liquid)):
        if is_given and len(command.photos) > 1 and option != "--fit":
            raise UsageError(f"{option}: is for one photograph, and {len(command.photos)} came.")
        if is_given and command.tank:
            raise UsageError(f"{option}: is for a ball, and --tank came.")
    if command.fit and command.liquid:
        raise UsageError("--fit: is for a ball in air, and --in came.")


def _in_words(otherwise: Sequence[Contradiction], several: bool, folder: Path) -> str:
    """What the photographs contradict, and what to do."""
    sizes = {
        "radius": "ball",
        "thickness": "tank",
        "wall": "walls",
        "wall_index": "walls",
        "liquid": "liquid",
        "wedge.x": "tank",
        "wedge.y": "tank",
    }
    ways = list(dict.fromkeys(f"measure {sizes[one.name]} and ruler again" for one in otherwise if one.name in sizes))
    ways += ["calibrate with this zoom and focus, and cut no picture"] * any(one.name not in sizes for one in otherwise)
    sheet = folder / ("located*.png" if several else "located.png")
    return (
        f"the photograph{'s contradict' if several else ' contradicts'} what was taken as known of "
        f"{'; of '.join(one.words for one in otherwise)} (millimetres of the board, degrees): do not believe the "
        f"index, {', '.join(ways)}, and look at {sheet} for corners that are none."
    )


def _ends(paths: Sequence[Path]) -> list[str]:
    """What distinguishes the files of each photograph: nothing for one, else its name, numbered where two have it."""
    stems = [path.stem for path in paths]
    if len(stems) == 1:
        return [""]
    return [f"_{stem}" if stems.count(stem) == 1 else f"_{stem}_{k + 1}" for k, stem in enumerate(stems)]


def _fit_light(command: Photo, together: Together, light: Sequence[Flattened | None], console: Console) -> int:
    """Fit the light of all photographs that have some, print what it says beside the corners, and write the report."""
    assert together.adjusted is not None, "a ball is found"
    # Those with a ball come first among the adjusted ones, in their order.
    of_located = [flat for result, flat in zip(together.photographs, light, strict=True) if result.located]
    all_seen = zip(together.located, of_located, together.adjusted.chains, strict=False)
    seen = [(located, flat, chain) for located, flat, chain in all_seen if flat]
    balls, pictures, chains = zip(*seen, strict=True)
    room = room_scene(balls, pictures, chains, together.adjusted.covariance)
    flats = dict(zip(room.scene.cameras, pictures, strict=True))
    targets = {name: flat.image for name, flat in flats.items()}
    weights = {name: flat.counts.astype(float) for name, flat in flats.items()}
    settings = {name: RenderSettings(crop=flat.grid.window) for name, flat in flats.items()}
    with FitProgress(scalar_names(room.scene, room.free), console, command.verbose) as show:
        result = fit(
            room.scene,
            targets,
            room.free,
            settings,
            options=light_options(room),
            weights=weights,
            shown=room.shown,
            on_step=show.step,
            on_phase=show.phase,
        )
    text = write_numbers(result, command.output)
    both, came_to_rest = combine(room, result), result.status in ("converged", "model_incomplete")
    write_text(command.output / "joined.json", json_text(both._asdict()))
    if command.json:
        sys.stdout.write(text)
    else:
        print_table("estimates", *estimate_table(result.parameters.values(), command.long))
        if came_to_rest:  # The board is its ruler, and its camera is the corners'.
            seen = result.check.looks
            print(
                f"{result.status}: the fit of the light came to rest{seen}. What that may move is in the total error."
            )
        else:
            print(last_word(result))
        index = result[room.glass[0]]
        indices = {"corners": together.located[0].ior, "light": (index.value, index.error), "both": both.ior}
        rows = [(by, with_error(*index, command.long)) for by, index in indices.items()]
        print_table("the index", ("by", "estimate"), rows)
        print(command.output, flush=True)
    off = both.apart
    if off > AGREE:
        print_warning(
            f"corners and light differ by {off:.1f} of their errors: look at {command.output / 'located.png'} for "
            "corners that are none, and at the report for reflections; believe neither index until you know why."
        )
    write_pictures(result, command.output, command.long)
    return 0 if came_to_rest and off <= AGREE else NOT_CONVERGED


def print_located(together: Together, long: bool = False) -> None:
    """Print what the corners say, with estimates as `with_error` writes them, and what the index's error is made of."""
    assert together.adjusted is not None, "a ball is found"
    count, first = len(together.photographs), together.located[0]
    results = [first.setup.numbers[k] for k in shown(first.setup)]
    names, own = [number.name for number in results], [number.name for number in results if number.is_own]

    def estimated(located: Located) -> dict[str, str]:
        """All numbers as `with_error` writes them, by name."""
        numbers = zip(located.setup.names, located.setup.vector, located.errors.vector, strict=True)
        return {name: with_error(float(number), float(error), long) for name, number, error in numbers}

    title = f"from the corners{f' of {count} photographs' * (count > 1)} (millimetres of the board, degrees)"
    estimates = estimated(first) | {"angle of view": estimated(first)["fov"]}
    listed = ["index", "angle of view", *(name for name in names[1:] if not (count > 1 and name in own))]
    print_table(title, ("number", "estimate"), [(name, estimates[name]) for name in listed])
    if count > 1:
        rows = []
        for result in sorted(together.photographs, key=lambda result: (not result.located, not result.is_bare)):
            cells = ["only the lens" if result.is_bare else "refused", *[""] * len(own)]
            if result.located:
                cells = [with_error(*result.index_alone, long), *(estimated(result.located)[name] for name in own)]
            rows.append((Path(result.photograph.name).name, *cells))
        print_table("each photograph", ("photograph", "index alone", *own), rows)
    parts = budget(together.adjusted)
    print_table("parts of the index's error", ("of", "part"), [(name, f"{x:.2g}") for name, x in parts.parts.items()])
    print(parts.advice)
    read = [(result.photograph.name, result, result.located) for result in together.photographs if result.located]
    for name, _, located in read:
        if max(located.shared) > 1:
            print_warning(
                f"{name}: corners through the tank scatter by {located.sigma[1]:.3f} pixels, and those beside it "
                f"by {located.sigma[0]:.3f}: something shifts neighbours alike, as walls that are not flat or a liquid "
                "that is not mixed. The index's error counts the excess once for nine neighbours, and may be too small."
            )
    for name, result, _ in read if count > 1 else ():
        index, error = result.index_alone
        if abs(off := index - first.ior[0]) > AGREE * error:
            print_warning(
                f"{name} alone tells an index of {with_error(index, error, long)}, {abs(off) / error:.1f} of its "
                "errors from that of all: is it the same ball or liquid, and does its sheet show corners that are none?"
            )


def _locate(command: Photo, photographs: Sequence[Photograph], board: CharucoBoard, measured: Measured) -> Together:
    """Find cameras and ball with what is known of the lens: from a calibration, else from EXIF, else nothing."""
    first, path, lens = photographs[0], command.photos[0], None
    if command.camera is not None:
        lens = read_lens(command.camera, first.size_on_sensor)
        lens = Turn(first.size_on_sensor, after=first.orientation).of(lens)
    warn_of_unmeasured(command)
    for photograph in photographs:
        # Few steps of a file part paper and ink where the brightest hundredth is so dark.
        if (white := float(np.percentile(photograph.light, 99))) < 0.03:
            print_warning(
                f"{photograph.name} is underexposed: its brightest hundredth has {100 * white:.1f} % of the light that "
                "the file can hold. The index may be off by more than its error: let paper have half."
            )
    photographs = turned_alike(photographs, board, is_tank="thickness" in measured)
    ball = Disc(np.array(command.ball[:2], float), float(command.ball[2])) if command.ball else None
    if lens is not None:
        return locate_together(photographs, board, measured, lens, ball)
    fov = angle_of_view(path) if is_photograph(path) else None
    if fov is not None:
        # EXIF's angle errs by some per cent: focal lengths are rounded, and focusing changes them. Nothing fits where
        # it is wrong, if the board does not outvote it.
        spread = 0.03
        together = locate_together(photographs, board, measured, uncalibrated(fov, spread * fov), ball)
        if together.located and abs(_angle_of_first(together)[0] / fov - 1) < 3 * spread:
            return together
    together = locate_together(photographs, board, measured, uncalibrated(), ball)
    if fov is not None and together.located:
        print_warning(
            f"{path}: its EXIF tells an angle of view of {fov:.4g} degrees (focal length, digital zoom), and "
            f"the board {with_error(*_angle_of_first(together))}: EXIF is not believed."
        )
    return together


def _angle_of_first(together: Together) -> tuple[float, float]:
    """The angle of view of the first photograph, and its error; another one may have been turned."""
    photographs = together.photographs
    result, located = next((result, result.located) for result in photographs if result.located)
    lens = result.photograph.turn_to(photographs[0].photograph).of(located.lens)
    return float(lens.mean[0]), float(lens.errors[0])
