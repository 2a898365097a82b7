"""The page of a fit's report: whole in itself, well formed, complete, harmless, and what a browser makes of it."""

import base64
import functools
import html.parser
import io
import re
import subprocess
from typing import get_args

import numpy as np
import pytest
from browsers import HEADLESS
from browsers import browser as browser
from fake_fit import changed, fake_result, full_result, two_views
from PIL import Image

from raytrace_jax import __version__, format_scene
from raytrace_jax.inverse.result import Status
from raytrace_jax.report.fit_report.figure import COLOURS, draw_report
from raytrace_jax.report.fit_report.folder import render_page
from raytrace_jax.report.fit_report.methods import methods_text

VOID = {"meta", "link", "img", "br", "wbr"}
HOSTILE = ("<script>alert(1)</script>", '"><img src=x onerror=alert(2)>', "a&amp;b$_{x}$c$\\frac$", "{{7*7}}.水'.ior")


class Page(html.parser.HTMLParser):
    """A page taken apart: its elements with their attributes, its text, and the tables' rows; every tag has its end."""

    def __init__(self, source):
        super().__init__()
        self.elements, self.rows, self.open, self.text = [], [], [], ""
        self.feed(source)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.text += data
        if self.open and ({"td", "th"} & set(self.open)):
            self.rows[-1][-1] += data

    def images(self):
        return [attributes for tag, attributes in self.elements if tag == "img"]


def text_of(result, scene=None):
    return render_page(result, format_scene(result.scene) if scene is None else scene, draw_report(result))


def page_of(result):
    return Page(text_of(result))


@functools.cache
def whole_page():
    return text_of(full_result())


def test_the_page_is_whole_in_itself():
    page = Page(whole_page())
    tags = [tag for tag, _ in page.elements]
    assert tags.count("html") == tags.count("title") == tags.count("h1") == 1
    assert not {"script", "iframe", "object", "embed", "form"} & set(tags)
    for tag, attributes in page.elements:
        for name in ("src", "href", "srcset", "data", "action", "poster"):
            assert attributes.get(name, "data:").startswith(("data:", "#")), (tag, name)
        assert not any(name.startswith("on") for name in attributes)
    source = whole_page()
    assert "url(" not in source and "@import" not in source


def test_the_pictures_are_the_result_s():
    result = full_result()
    stored = base64.b64decode(Page(whole_page()).images()[0]["src"].partition(",")[2])
    np.testing.assert_array_equal(
        np.asarray(Image.open(io.BytesIO(stored))), np.floor(255 * result.target).T.swapaxes(0, 1)
    )
    many = np.zeros((3, 2, 3300))
    large = changed(result, target=many, image=many, start_image=many, weights=many + 1)
    assert [int(image["width"]) for image in page_of(large).images()[:4]] == [1100] * 4


ERRORS = ("error", "of noise", "of the model", "Cramér–Rao bound")


def most(shift: str) -> str:
    """What an estimate of the result depends on most, as its table has it."""
    return f"cyan.alpha: +0.0004 moves it by +{shift}"


def test_the_page_says_all_of_the_result():
    result, page = full_result(), Page(whole_page())
    for text in (
        *("ambiguous", result.message, result.advice, result.uncertainty.weakest, result.rests_on, "2.43/255"),
        *("7 pixels at edges", "reduced chi-square", "1.02", "41.7", "80 × 60", "4,640 count"),
        *("central.radius is tied to vitreous.radius", "95 %: 1.33667 to 1.33764", "95 %: above 2.2907"),
        *("@software{raytrace_jax", "{{The raytrace_jax developers}}", __version__, methods_text(result).strip()),
        format_scene(result.scene).strip(),
    ):
        assert text in page.text, text
    for row in (
        ["name", "start", "estimate", *ERRORS, "prior", "depends most on"],
        ["vitreous.ior", "1.5", "1.33712(28)", "0.00028", "0.00023", "0.00016", "0.00021", "–", most("4 × 10⁻⁷")],
        ["vitreous.center.x", "4", "4.2995(13)", "0.0013", "0.0011", "0.00077", "0.0010", "–", most("1.2 × 10⁻⁶")],
        ["topright.location.x +0.27 %", "8.2", "free it, or measure it"],
        ["cyan.alpha", "0.4", "–", "4 × 10⁻⁷", "1.2 × 10⁻⁶", "4 × 10⁻⁷", "1.2 × 10⁻⁶"],
        ["", "candidate 0", "candidate 2", "candidate 1"],
        ["vitreous.ior", "1.33712", "1.71012", "1.04712"],
        ["rms residual [1/255]", "2.43", "2.46", "7.9"],
        ["evidence", "–", "1.8", "14.2"],
        ["verdict", "estimate", "cannot be told apart", "does not explain it"],
        ["2", "vitreous.center.x", f"{result.uncertainty.correlation[1, 0]:.2f}".replace("-", "−"), "1"],
        ["size", "80, 60"],
        ["second root", "on"],
    ):
        assert row in page.rows, row


def test_a_small_result_has_a_small_page():
    page = page_of(fake_result())
    assert ["vitreous.radius", "2", "2.3", "not determined", "not determined"] in page.rows
    assert ["2", "vitreous.radius", "–", "1"] in page.rows
    assert "estimated from the residual" in page.text and "infinite" in page.text
    assert "no two parameters are determined" in page.text
    for text in ("Other minima", "Profile", "tied", "prior", "reduced chi-square", "Vuong", "grey"):
        assert text not in page.text
    assert "Correlation" not in page_of(fake_result(names=("vitreous.ior",))).text


def test_the_page_says_what_each_view_tells_alone():
    result = two_views()
    page = page_of(result)
    for row in (
        ["view", *result.labels],
        ["left", "1.33710(46)", "not determined"],
        ["right/b", "not determined", "not determined"],
        ["all together", "1.33700(23)", "not determined"],
    ):
        assert row in page.rows, row
    shown = [image["alt"] for image in page.images()[:8]]
    assert shown == [f"{c}: {name}" for c in ("left", "right/b") for name in ("target", "start", "fit", "fit − target")]
    assert [image["width"] for image in page.images()[:8]] == ["40"] * 4 + ["20"] * 4
    for text in ("rms residual: 2.55/255", "rms residual: 5.1/255", "pixels: 20 × 24 (all count)"):
        assert page.text.count(text) == 1, text
    assert "tells alone" not in page_of(fake_result()).text
    assert "tells alone" not in page_of(changed(result, alone=())).text


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("count", [1, 3, 12])
def test_the_corner_has_the_most_correlated(count):
    result = full_result(names=tuple(f"shape{i}.ior" for i in range(count)))
    shown = [image["alt"] for image in page_of(result).images() if image["alt"].startswith("95 % ellipses")]
    assert len(shown) == (count > 1)
    if shown:
        names = shown[0].removeprefix("95 % ellipses of ").split(", ")
        assert names == sorted(names, key=result.names.index) and len(names) == min(count, 6)
        sizes = np.where(np.tri(count, k=-1) > 0, np.abs(result.uncertainty.correlation), 0)
        most = np.unravel_index(np.argmax(sizes), sizes.shape)
        assert {result.names[k] for k in most} <= set(names)


def test_every_status_has_its_colour():
    assert set(COLOURS) == set(get_args(Status))
    page = text_of(fake_result("not_converged"))
    assert "<h1>not converged</h1>" in page and f"--status: {COLOURS['not_converged']};" in page


@pytest.mark.filterwarnings("error")
def test_hostile_names_and_scenes_are_text(tmp_path):
    result = full_result(names=HOSTILE)
    result = changed(result, message="</p><b>", advice="<i>", uncertainty={"weakest": "<u>"})
    result.save(tmp_path)
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert not {"script", "b", "i", "u"} & {tag for tag, _ in page.elements}
    assert len(page.images()) == 4 + 1 + 2 + 5
    for name in HOSTILE:
        assert [row[0] for row in page.rows].count(name) == 2
        assert name in page.text
    assert "<script>x" in Page(text_of(result, "<script>x")).text


@pytest.mark.slow
@pytest.mark.parametrize(("width", "count"), [(1200, 4), (420, 12)])
def test_a_browser_shows_the_page(browser, width, count, tmp_path):
    names = tuple(f"a_rather_long_name_of_a_shape_{i}.center.x" for i in range(count))
    full_result(names=names).save(tmp_path / "fit")
    address = (tmp_path / "fit" / "report.html").as_uri()
    options = [*HEADLESS, f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},3000"]

    screenshot = tmp_path / "page.png"
    command = [browser, *options, f"--screenshot={screenshot}", address]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "CONSOLE" not in done.stderr
    with Image.open(screenshot) as image:
        assert image.format == "PNG" and image.width == width
        pixels = np.asarray(image.convert("RGB"))
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 100
    # Nothing reaches into the margins: whatever is too wide scrolls in its own box.
    for margin in (pixels[:, :10], pixels[:, -10:]):
        assert (margin == margin[0, 0]).all()

    done = subprocess.run([browser, *options, "--dump-dom", address], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "CONSOLE" not in done.stderr
    page = Page(re.sub("<!DOCTYPE[^>]*>", "", done.stdout))
    assert [names[0], "1.5", "1.33712(28)", "0.00028", "0.00023", "0.00016", "0.00021", "–"] in [
        r[:8] for r in page.rows
    ]
    assert len(page.images()) == len(page_of(full_result(names=names)).images())
