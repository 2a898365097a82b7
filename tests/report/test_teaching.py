"""The lessons' figures: what they claim is so, and the command that writes them."""

import time

import numpy as np
import pytest
from command_line import run
from matplotlib.figure import Figure
from PIL import Image

from raytrace_jax import glass
from raytrace_jax.cli import progress
from raytrace_jax.report.lessons.formulas import RED, SQUARE_ROOTS, cosine_and_slopes
from raytrace_jax.report.lessons.pictures import (
    LESSONS,
    SCHOTT,
    WORK,
    draw_cost,
    draw_dispersion,
    draw_edges,
    index_page,
    schott_index,
)

FORMULAS = [name for name in LESSONS if name not in WORK and name != "ray"]


def lines_of(ax):
    return {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("name", FORMULAS)
def test_every_panel_has_title_and_legend(name):
    figure = LESSONS[name]()
    assert isinstance(figure, Figure) and figure.get_suptitle()
    for ax in figure.axes:
        if not ax.axison:  # A drawing.
            assert ax.get_title() and len(ax.get_lines()) > 3
            continue
        assert ax.get_xlabel() and ax.get_ylabel() and ax.get_legend() is not None
        assert any(unit in ax.get_xlabel() for unit in ("[degrees]", "[radii]", "index of refraction n"))


def test_rays_obey_snell_and_fresnel():
    figure = LESSONS["ray"]()
    titles = [ax.get_title() for ax in figure.axes]
    assert len(set(titles)) == 6 and next(iter(LESSONS)) == "ray"
    for ax, degrees in zip(figure.axes, (20, 50, 80, 20, 40, 55), strict=True):
        out = "out of" in ax.get_title()
        n, theta = (1 / 1.5 if out else 1.5), np.radians(degrees)
        rays = lines_of(ax)
        ends = {name: np.array([ray.get_xdata()[1], ray.get_ydata()[1]]) for name, ray in rays.items()}
        side = -1 if out else 1
        assert ends["incident"] == pytest.approx([-np.sin(theta), side * np.cos(theta)])
        assert ends["reflected"] == pytest.approx([np.sin(theta), side * np.cos(theta)])
        widths = {name: ray.get_linewidth() / rays["incident"].get_linewidth() for name, ray in rays.items()}
        words = " ".join(text.get_text() for text in ax.texts)
        if np.sin(theta) > n:
            assert widths == {"incident": 1, "reflected": 1} and "refracted" not in words
            continue
        t = np.arcsin(np.sin(theta) / n)
        assert ends["refracted"] == pytest.approx([np.sin(t), -side * np.cos(t)], abs=1e-6)
        # Fresnel's equations as sines and tangents (Born and Wolf, 1.5.2).
        share = (np.sin(theta - t) / np.sin(theta + t)) ** 2 / 2 + (np.tan(theta - t) / np.tan(theta + t)) ** 2 / 2
        assert widths["reflected"] == pytest.approx(share, rel=1e-4)
        assert widths["reflected"] + widths["refracted"] == pytest.approx(1)
        assert f"refracted {100 - 100 * share:.1f} %\n{np.degrees(t):.1f}°" in words


def test_rays_of_bodies_are_traced_where_the_law_says():
    """Snell's law, the deviation and the lensmaker's focus are written or marked, and traced rays are there."""
    figure = LESSONS["half_disc"]()
    assert "critical angle is 41.8°" in figure.get_suptitle()
    written = [[text.get_text() for text in ax.texts] for ax in figure.axes]
    behind = [f"{np.degrees(np.arcsin(1.5 * np.sin(np.radians(degrees)))):.1f}°" for degrees in (25, 40)]
    assert written == [["25.0°"] * 2 + behind[:1], ["40.0°"] * 2 + behind[1:], ["50.0°"] * 2]
    rays, curve = LESSONS["prism"]().axes
    assert [text.get_text() for text in rays.texts] == ["48.6°", "48.6°", "60.0°", "D = 37.2°"]
    lines = lines_of(curve)
    formula = lines[r"$\theta_i + \theta_o - A$"].get_ydata()
    assert lines["traced"].get_ydata() == pytest.approx(formula, abs=1e-9)
    assert "least: D = 37.18° at 48.6°" in lines and "1.5000 ± 0.0012" in curve.texts[0].get_text()
    (ax,) = LESSONS["lens"]().axes
    (focus,) = (line.get_xdata()[0] for line in ax.get_lines() if line.get_color() == RED)
    ends = np.array([line.get_xydata() for line in ax.get_lines() if len(line.get_xdata()) == 2])
    o, d = ends[:, 0], ends[:, 1] - ends[:, 0]
    behind = (o[:, 0] > 0) & (o[:, 1] > 0.01)
    height, crossing = o[behind, 1], (o[:, 0] - o[:, 1] * d[:, 0] / np.where(d[:, 1], d[:, 1], 1))[behind]
    order = np.argsort(height)
    assert len(order) == 7 and np.all(np.diff(crossing[order]) < 0)
    assert crossing[order][0] == pytest.approx(focus, rel=5e-3) and crossing[order][0] < focus


@pytest.mark.parametrize("name", ["snell", "fresnel", "total_reflection"])
def test_titles_differ_and_no_line_looks_like_data(name):
    axes = LESSONS[name]().axes
    titles = [ax.get_title() for ax in axes if ax.get_title()]
    assert len(titles) == len(set(titles))
    for ax in axes:
        low, high = ax.get_ylim()
        for line in ax.get_lines():
            x, y = (np.asarray(part, float) for part in line.get_data())
            if len(x) > 100:  # A curve; what is cut off at the panel's border goes to infinity.
                steps = np.abs(np.diff(np.clip(y, low, high)))
                assert np.nanmax(steps) < 0.5 * (high - low)
            elif len(x) == 2:
                assert line.get_linestyle() == ":"
        if name == "snell":
            ends = [line.get_ydata() for line in ax.get_lines() if line.get_color() != RED]
            assert all(low <= np.min(y) and np.max(y) <= high for y in ends)


def test_the_glasses_of_dispersion_are_those_of_the_catalogue():
    x = np.linspace(400, 700, 31)
    for name in SCHOTT:
        assert schott_index(name, x) == pytest.approx(glass.named(f"SCHOTT {name}").index(x), abs=1e-6)


def test_a_rim_has_colours_by_dispersion_alone():
    curves, *shown = draw_dispersion(size=48).axes
    labels = list(lines_of(curves))
    assert "N-BK7: 1.5168, 64.2" in labels and "N-SF11: 1.7847, 25.7" in labels
    assert {"F", "d", "C", "red\n610", "green\n550", "blue\n465"} == {text.get_text() for text in curves.texts}
    spread = [np.ptp(ax.images[0].get_array().astype(int), axis=-1).max() for ax in shown]
    assert max(spread[:2]) <= 1 and min(spread[2:]) > 60


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
    assert {*WORK} <= {*LESSONS}
    page = (out / "index.md").read_text()
    assert page == index_page(("snell", "critical"))
    assert "![The critical angle](critical.png)\n\nFrom inside, light leaves" in page and "fresnel.png" not in page
    assert run("teach", "-o", out, "--only", "critical", "--also", "svg", "--also", "pdf", "--quiet") == 0
    assert capsys.readouterr().err == ""
    assert (out / "critical.svg").read_text().startswith("<?xml")
    assert (out / "critical.pdf").read_bytes().startswith(b"%PDF")


def test_it_says_what_it_waits_for(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(progress, "SILENCE", 0.0)
    monkeypatch.setitem(LESSONS, "cost", lambda: time.sleep(1.2) or Figure())
    assert run("teach", "-o", tmp_path, "--only", "cost") == 0
    assert "figure 1/1, cost: 121 pictures\n" in capsys.readouterr().err
