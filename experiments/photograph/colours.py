"""Rooms by POV-Ray with balls of glasses from catalogues: what does one photograph say of index and dispersion?

    python experiments/photograph/colours.py FOLDER [NUMBER ...]

Needs the program `povray` and the extras `photo` and `glass`. Each of ten rooms is rendered three times, with the
indices of its glass at wavelengths near those of a usual sensor, and a channel of each is taken. The lens draws red
larger than blue by nearly two pixels at the picture's corner, and every other JPEG has half its colours' pixels. The
radius is known to 5 micrometres; nothing is known of the lens. FOLDER gets `colours_N.jpg` and the truth beside it.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import povray
import rooms
from PIL import Image
from scipy import ndimage

SIZE = povray.SIZE = rooms.SIZE = (1200, 900)
rooms.RADIOSITY = rooms.AMBIENT  # Which light falls on the board does not matter here.

from chain import Chain, exposure, noisy, srgb  # noqa: E402

from raytrace_jax import enable_compile_cache, glass, read_picture  # noqa: E402
from raytrace_jax.images.jpeg import jpeg_storage  # noqa: E402
from raytrace_jax.optics.dispersion import dispersion  # noqa: E402
from raytrace_jax.photo.boards import read_board  # noqa: E402
from raytrace_jax.photo.colours import WAVELENGTHS, colour_differences  # noqa: E402
from raytrace_jax.photo.lens import uncalibrated  # noqa: E402
from raytrace_jax.photo.locate import locate_together  # noqa: E402
from raytrace_jax.photo.photograph import photograph_of  # noqa: E402

GLASSES = {
    40: "N-BK7", 41: "N-SF66", 43: "N-SF11", 44: "N-FK51A", 46: "N-LAK8", 47: "SCHOTT F2", 49: "N-BAF10", 50: "J-SF6",
    52: "S-FPL53", 53: "N-K5",
}  # fmt: skip
"""The glass of each room, by the number that draws the room."""

LATERAL = (1.0 / 750, 0.0, -0.7 / 750)
"""By how much each channel is drawn larger."""


def take(number: int, folder: Path) -> None:
    """Make the photograph of a room, and its truth."""
    path, random = folder / f"colours_{number}.jpg", np.random.default_rng(9000 + number)
    if path.exists():
        return
    material, truth = glass.named(GLASSES[number]), rooms.drawn(number)
    wavelengths = np.array([wavelength for wavelength, _ in WAVELENGTHS]) + random.normal(0, 4, 3)
    index, n_d = material.index(wavelengths), material.n_d
    truth["center"][2] = truth["radius"] * n_d / (2 * (n_d - 1)) * random.uniform(1.7, 2.5)
    board = povray.made(folder / f"board_{truth['paper']}.pdf", truth["paper"])
    views = truth["eye"], truth["lookat"], truth["roll"]
    texts = [rooms.room(truth | {"ior": float(n)}, board, *views, ball=True) for n in index]
    light = np.stack([povray.rendered(text, SIZE)[channel] for channel, text in enumerate(texts)])
    middle = (np.array(light.shape[1:]) - 1)[:, None, None] / 2
    places = [middle + (np.indices(light.shape[1:]) - middle) / (1 + larger) for larger in LATERAL]
    light = np.stack(
        [ndimage.map_coordinates(*both, order=3, mode="nearest") for both in zip(light, places, strict=True)]
    )
    chain = Chain(**truth["chain"] | {"gains": tuple(truth["chain"]["gains"])})
    signal = noisy(exposure(0.8 / np.percentile(light, 98) * light, chain), chain)
    pixels = np.round(255 * np.moveaxis(srgb(np.clip(signal, 0, 1)), 0, -1)).astype(np.uint8)
    Image.fromarray(pixels).save(path, "JPEG", quality=chain.quality, subsampling=2 if number % 2 == 0 else 0)
    truth |= {"glass": str(material), "index": index.tolist(), "n_d": n_d, "abbe": material.V_d}
    path.with_suffix(".json").write_text(json.dumps(truth, indent=1))


def row(number: int, folder: Path) -> str:
    """What a photograph says, beside the truth."""
    path = folder / f"colours_{number}.jpg"
    truth, image = json.loads(path.with_suffix(".json").read_text()), read_picture(path)
    board, begun = read_board(folder / f"board_{truth['paper']}.txt"), time.monotonic()
    radius = {"radius": (truth["radius"] / truth["print_scale"], 0.005)}
    (result,) = locate_together([photograph_of(image, path.name)], board, radius, uncalibrated()).photographs
    assert result.located is not None, result.reason
    corners, storage = time.monotonic(), jpeg_storage(path)
    differences = colour_differences(image, result.located, storage)
    assert differences is not None and storage is not None
    seconds = time.monotonic() - corners
    found = dispersion(*differences.indices(result.located.ior), WAVELENGTHS)
    (n_error, abbe_error), name = found.errors, truth["glass"]
    materials = glass.find(found.n_d, n_error, abbe=found.abbe, abbe_error=abbe_error)
    solid = [material for material in materials if material.kind != "liquid"]
    is_listed = any(name in (str(material), *material.others) for material in solid)
    apart, true = differences.of_index[2] - differences.of_index[0], truth["index"][2] - truth["index"][0]
    cells = (
        name,
        "4:4:4" if storage.subsampling == 0 else "4:2:0",
        f"{truth['n_d']:.4f}",
        f"{found.n_d:.4f} ± {n_error:.4f} ({(found.n_d - truth['n_d']) / n_error:+.1f})",
        f"{truth['abbe']:.1f}",
        f"{found.abbe:.1f} ± {abbe_error:.1f} ({(found.abbe - truth['abbe']) / abbe_error:+.1f})",
        f"{1e4 * true:.1f}",
        f"{1e4 * apart:.1f}",
        f"{'yes' if is_listed else 'no'}, {len(solid)}",
        f"{seconds / (corners - begun):.0%}",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Make the photographs that are missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("numbers", type=int, nargs="*", default=list(GLASSES))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    enable_compile_cache()
    heads = (
        "glass",
        "JPEG",
        "n_d",
        "read (errors off)",
        "V_d",
        "read",
        "1e4 (n_B - n_R)",
        "read",
        "listed, of",
        "slower by",
    )
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for number in given.numbers:
        take(number, given.folder.resolve())
        print(row(number, given.folder.resolve()), flush=True)


if __name__ == "__main__":
    main()
