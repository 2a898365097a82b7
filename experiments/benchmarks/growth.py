"""How time grows with pixels, shapes, parameters, bounces and devices: one table in Markdown, and a plot.

python experiments/benchmarks/growth.py -o growth.png
"""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import tyro
from matplotlib.ticker import FuncFormatter, NullFormatter
from rich.console import Console

HERE = Path(__file__).parent
Series = Literal["pixels", "shapes", "parameters", "bounces"]
AXES: dict[Series, str] = {
    "pixels": "pixels of the picture",
    "shapes": "balls, 320 x 240",
    "parameters": "parameters of the derivative, 320 x 240",
    "bounces": "bounces, 320 x 240",
}
"""What is varied."""


@dataclass(frozen=True)
class Options:
    """Measure how the time of a picture grows; the table goes to stdout."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The plot, a PNG file."""
    series: tuple[Series, ...] = tuple(AXES)
    """What to vary."""
    devices: tuple[int, ...] = (1, 2)
    """On how many devices, each a core."""
    count: int | None = None
    """Only the first so many sizes of each series; all of them take a quarter of an hour."""


def main(options: Options) -> None:
    say = Console(stderr=True, highlight=False).print
    print("| what | how many | devices | ms | first call, s | peak, MB |\n|---|---|---|---|---|---|", flush=True)
    figure, panels = plt.subplots(1, len(options.series), figsize=(4 * len(options.series), 3.6), squeeze=False)
    for panel, series in zip(panels[0], options.series, strict=True):
        for devices in options.devices:
            say(f"{series}, {devices} devices ...")
            found = measure(series, devices, options.count)
            for row in found:
                numbers = f"{row['ms']:.3g} | {row['first_s']:.1f} | {row['peak_mb']:.0f}"
                print(f"| {series} | {row['size']:,} | {devices} | {numbers} |", flush=True)
            sizes, times = ([row[key] for row in found] for key in ("size", "ms"))
            label = "1 device" if devices == 1 else f"{devices} devices"
            panel.loglog(sizes, times, "o-", label=label) if min(sizes) else panel.plot(sizes, times, "o-", label=label)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,.0f}"))
            axis.set_minor_formatter(NullFormatter())
        panel.set_xlabel(AXES[series])
        panel.grid(True, which="major", alpha=0.3)
        panels[0][0].set_ylabel("least time, ms")
        panels[0][0].legend(frameon=False)
        # After each of them: all together they take a quarter of an hour.
        figure.tight_layout()
        figure.savefig(options.output, dpi=120)


def measure(series: Series, devices: int, count: int | None) -> list[dict[str, float]]:
    """What `growing.py` prints."""
    command = [sys.executable, str(HERE / "growing.py"), series, str(devices), *([] if count is None else [str(count)])]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


if __name__ == "__main__":
    main(tyro.cli(Options))
