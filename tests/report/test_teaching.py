"""The lessons' figures: what they claim is so, and the command that writes them."""

import numpy as np
import pytest
from command_line import run
from matplotlib.figure import Figure
from PIL import Image

from raytrace_jax.report.lessons.formulas import SQUARE_ROOTS, cosine_and_slopes
from raytrace_jax.report.lessons.pictures import LESSONS, draw_cost, draw_edges, index_page

FORMULAS = [name for name in LESSONS if name not in ("edges", "cost")]


def lines_of(ax):
    return {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("name", FORMULAS)
def test_every_panel_has_title_and_legend(name):
    figure = LESSONS[name]()
    assert isinstance(figure, Figure) and figure.get_suptitle()
    for ax in figure.axes:
        assert ax.get_xlabel() and ax.get_ylabel() and ax.get_legend() is not None
        assert any(unit in ax.get_xlabel() for unit in ("[degrees]", "[radii]", "index of refraction n"))


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("name", ["snell", "ball"])
def test_closed_forms_lie_on_the_derivatives(name):
    compared = 0
    for ax in LESSONS[name]().axes:
        lines = [line for line in ax.get_lines() if line.get_marker() in ("None", None, "")]
        for dots in (line for line in ax.get_lines() if line.get_marker() == "."):
            same = [line for line in lines if line.get_color() == dots.get_color()]
            x, y = dots.get_data()
            nearest = min(np.abs(np.interp(x, *line.get_data()) - y).max() for line in same)
            assert nearest < 1e-9 * max(1, np.abs(y).max())
            compared += 1
    assert compared >= 3


def test_only_a_guarded_root_stays_finite():
    beyond = np.radians([50.0, 60.0])
    finite = [[bool(np.isfinite(x).all()) for x in cosine_and_slopes(f, beyond, 1.5)] for _, _, f in SQUARE_ROOTS]
    # Value, forward mode, reverse mode: as it stands; guarded output; guarded input.
    assert finite == [[False, False, False], [True, True, False], [True, True, True]]


@pytest.mark.slow
def test_point_derivatives_miss_edges():
    figure = draw_edges(size=(64, 48), samples=6)
    notes = [ax.get_xlabel() for ax in figure.axes if "correlation" in ax.get_xlabel()]
    correlations = [float(note.split()[-1]) for note in notes]
    assert len(correlations) == 4
    for point, aware in zip(correlations[::2], correlations[1::2], strict=True):
        assert point < 0.8 < 0.9 < aware


@pytest.mark.slow
def test_blur_removes_the_kink_of_the_cost():
    figure = draw_cost(size=(64, 48), count=25)
    cost = figure.axes[2]
    curves = lines_of(cost)
    sharp, blurred = curves["sharp"].get_data(), curves["blurred, σ = 6 pixels"].get_data()
    near = int(np.argmin(np.abs(sharp[0] - 1.5)))
    for x, y in (sharp, blurred):
        assert abs(x[np.argmin(y)] - 1.5) < 1e-9 and y[near] < 1e-12
    # Of a parabola a step of two costs four times a step of one, of a kink twice.
    growth = [(y[near + 2] + y[near - 2]) / (y[near + 1] + y[near - 1]) for _, y in (sharp, blurred)]
    assert growth[0] < growth[1] and growth[1] > 3
    # The second minimum of which the text speaks.
    assert blurred[1][0] < 0.5 * blurred[1][: near + 1].max()


def test_the_command_writes_figures_and_page(tmp_path, capsys):
    out = tmp_path / "new" / "lecture"
    assert run("teach", "-o", out, "--only", "critical", "snell", "--only", "critical") == 0
    captured = capsys.readouterr()
    assert captured.out.split() == [str(out / name) for name in ("snell.png", "critical.png", "index.md")]
    assert "figure 2/2, critical" in captured.err
    for name in ("snell", "critical"):
        with Image.open(out / f"{name}.png") as picture:
            assert picture.width > 1000
    page = (out / "index.md").read_text()
    assert page == index_page(("snell", "critical"))
    assert "![The critical angle](critical.png)\n\nFrom inside, light leaves" in page and "fresnel.png" not in page
    assert run("teach", "-o", out, "--only", "critical", "--also", "svg", "--also", "pdf", "--quiet") == 0
    assert capsys.readouterr().err == ""
    assert (out / "critical.svg").read_text().startswith("<?xml")
    assert (out / "critical.pdf").read_bytes().startswith(b"%PDF")
