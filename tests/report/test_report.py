"""The report of a fit: its files hold what the result holds, whole or not at all."""

import csv
import dataclasses
import io
import json
import re
from string import ascii_lowercase

import hypothesis.strategies as st
import numpy as np
import pytest
from fake_fit import changed, fake_result, full_result, two_views
from hypothesis import given
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import raytrace_jax
from raytrace_jax import RaytraceError, format_scene, load_scene, read_exr
from raytrace_jax.inverse.judge.model_check import ModelCheck
from raytrace_jax.inverse.result import ELLIPSE_95
from raytrace_jax.report.fit_report.curves import draw_profile, ellipse
from raytrace_jax.report.fit_report.figure import draw_report, residual_of
from raytrace_jax.report.fit_report.methods import methods_text, references
from raytrace_jax.report.fit_report.summary import csv_table, estimate_line, facts, number_text, tex_table
from raytrace_jax.util.digits import value_and_error, with_error

FILES = ["estimates.csv", "estimates.tex", "fit.exr", "fit.txt", "methods.txt", "report.html", "report.png"]
FILES += ["residual.exr", "result.json", "result.npz"]


def refuse_constant(name):
    raise AssertionError(f"{name} is not JSON")


def read_summary(folder):
    return json.loads((folder / "result.json").read_text(encoding="utf-8"), parse_constant=refuse_constant)


def test_the_files_hold_the_result(tmp_path):
    result = fake_result()
    folder = tmp_path / "new" / "fit"
    result.save(folder, pdf=True)
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF-")
    result.save(folder)
    assert sorted(path.name for path in folder.iterdir()) == FILES

    summary = read_summary(folder)
    assert summary["status"] == "converged" and summary["message"] == result.message
    assert summary["parameters"]["vitreous.ior"] == {
        "value": 1.337,
        "initial": 1.5,
        "standard_error": 2.3e-4,
        "resolution": 0.0,
        "systematic_error": 0.0,
        "total_error": 2.3e-4,
        "cramer_rao": 1.9e-4,
        "unit": "unit of index",
    }
    assert summary["parameters"]["vitreous.radius"]["standard_error"] is None
    assert summary["parameters"]["vitreous.radius"]["cramer_rao"] is None
    assert summary["correlation"] == {"names": list(result.names), "matrix": [[1.0, None], [None, 1.0]]}
    assert summary["rms_residual"] == result.rms_residual
    assert summary["condition_number"] is None and summary["reduced_chi_square"] is None
    for entry, step in zip(summary["history"], result.steps, strict=True):
        assert entry == {**dataclasses.asdict(step), "value": step.value.tolist()}
    assert summary["settings"]["size"] == summary["provenance"]["target_size"] == [40, 30]
    assert summary["provenance"]["stages"] == {"up to the first step": 0.0, "blur 2 px": 0.5, "no blur": 1.0}
    assert summary["versions"]["raytrace_jax"] == raytrace_jax.__version__
    assert set(summary["versions"]) > {"jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "python"}
    assert summary["scene"] == (folder / "fit.txt").read_text() == format_scene(result.scene)

    estimate = result.image
    for name, image in (("fit.exr", estimate), ("residual.exr", estimate - result.target)):
        picture = read_exr(folder / name)
        stored = np.stack([picture.channels[channel] for channel in "RGB"])
        np.testing.assert_array_equal(stored, image.astype(np.float32))
        assert picture.metadata["scene"] == summary["scene"]
    with Image.open(folder / "report.png") as figure:
        assert figure.width == 1800


def test_json_holds_all_but_the_pictures(tmp_path):
    result = full_result()
    result.save(tmp_path)
    summary = read_summary(tmp_path)
    for name in ("sigma", "sigma_given", "reduced_chi_square", "condition_number", "weakest"):
        assert summary[name] == getattr(result.uncertainty, name)
    assert (summary["advice"], summary["loss"]) == (result.advice, result.loss)
    assert [entry["candidate"] for entry in summary["history"]] == [step.candidate for step in result.steps]
    assert summary["priors"] == [{"name": "vitreous.radius", "mean": 2.3, "standard_deviation": 0.05}]
    assert summary["ties"] == [{"follower": "central.radius", "leader": "vitreous.radius"}]
    for entry, minimum in zip(summary["runner_ups"], result.runner_ups, strict=True):
        assert entry == {**dataclasses.asdict(minimum), "value": minimum.value.tolist()}
    for entry, profile in zip(summary["profiles"], result.profiles, strict=True):
        assert entry["name"] == profile.name and entry["value"] == profile.value.tolist()
        assert entry["chi_square"] == profile.chi_square.tolist() and entry["others"] == profile.others.tolist()
        assert entry["interval"] == [end if np.isfinite(end) else None for end in profile.interval]
    fields = {field.name for part in (result, result.uncertainty, result.check) for field in dataclasses.fields(part)}
    pictures = {"target", "start_image", "image", "weights", "further_views", "alone"}
    regrouped = {"names", "value", "resolution", "initial", "standard_error", "cramer_rao", "units", "assumptions"}
    regrouped |= {"covariance", "undetermined", "stated", "structure", "uncertainty", "check", "steps"}
    regrouped |= {"distant_correlation", "is_structured", "displaced"}
    added = {"history", "parameters", "versions", "sensitivity", "uncertain", "rests_on", "depends_on", "correlation"}
    added |= {"dispersions"}
    assert set(summary) == fields - pictures - regrouped | added
    assert summary["sensitivity"]["cyan.alpha"]["vitreous.ior"] == 0.001
    assert summary["uncertain"] == {"topright.location.x": 0.01}
    assert summary["causes"][0]["words"] == "topright.location.x +0.27 %"
    assert summary["rests_on"] == result.rests_on
    assert summary["depends_on"]["vitreous.ior"]["on"] == "cyan.alpha"
    assert summary["settings"]["reflectance"] == "schlick" and "least_weight" not in summary["settings"]


def test_each_view_has_its_pictures(tmp_path):
    result = two_views()
    result.save(tmp_path)
    pictures = {f"{kind}_{end}.exr" for kind in ("fit", "residual") for end in ("left", "right%2Fb")}
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {*FILES, *pictures} - {"fit.exr", "residual.exr"}
    for camera, view in result.views.items():
        end = camera.replace("/", "%2F")
        for file, image in ((f"fit_{end}.exr", view.image), (f"residual_{end}.exr", view.image - view.target)):
            picture = read_exr(tmp_path / file)
            np.testing.assert_array_equal(np.stack([picture.channels[c] for c in "RGB"]), image.astype(np.float32))
            assert picture.metadata["camera"] == camera
    summary = read_summary(tmp_path)
    left, right = summary["views"]
    ior = result.value[0]
    assert (left["camera"], left["rms_residual"], left["target_samples"]) == ("left", 0.01, None)
    assert left["alone"]["vitreous.ior"] == {"value": ior + 1e-4, "standard_error": 4.6e-4}
    assert (right["rms_residual"], right["left_out"], right["target_samples"]) == (0.02, 3, 8)
    assert right["alone"]["vitreous.ior"] == {"value": ior, "standard_error": None}
    assert load_scene(tmp_path / "fit.txt").cameras == ("left", "right/b")

    # A fit of one view takes the pictures of the others away, and nothing else.
    (tmp_path / "fit_mine.exr").touch()
    fake_result().save(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "fit_mine.exr"}
    assert "views" not in read_summary(tmp_path)
    stopped = dataclasses.replace(result.further_views[0], image=None, start_image=None)
    dataclasses.replace(result, image=None, alone=(), further_views=(stopped,)).save(tmp_path)
    assert [view["alone"] for view in read_summary(tmp_path)["views"]] == [None, None]
    assert not {path.name for path in tmp_path.iterdir()} & pictures


@pytest.mark.filterwarnings("error")
def test_the_figure_has_a_row_for_each_view():
    figure = draw_report(two_views()).figure
    titles = [ax.get_title() for ax in figure.axes if ax.get_visible() and ax.get_title()]
    for k, camera in enumerate(("left", "right/b")):
        row = [title.partition(") ")[2] for title in titles[4 * k : 4 * k + 4]]
        assert row == [f"{camera}: {name}" for name in ("target", "start", "fit", "fit − target, worst channel")]
    assert len(titles) == 8 + 1 + 2
    above = figure.subfigs[0].texts[0].get_text().splitlines()
    assert above[1].startswith("left: rms residual 2.55/255") and above[2].startswith("right/b: rms residual 5.1/255")
    boxes = [text.get_window_extent() for part in (figure, *figure.subfigs) for text in part.texts]
    boxes += [ax.title.get_window_extent() for ax in figure.axes if ax.get_title()]
    assert not any(box.overlaps(other) for i, box in enumerate(boxes) for other in boxes[:i])


def test_a_failure_leaves_no_old_pictures(tmp_path):
    fake_result().save(tmp_path)
    broken = changed(fake_result("ambiguous"), image=np.full((3, 30, 40), np.nan))
    with pytest.raises(RaytraceError, match="NaN"):
        broken.save(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"result.json", "fit.txt"}
    assert read_summary(tmp_path)["status"] == "ambiguous"


@pytest.mark.parametrize(
    ("stage", "file", "absent"), [("draw_report", "report.png", 2), ("render_page", "report.html", 1)]
)
def test_numbers_are_written_first(stage, file, absent, tmp_path, monkeypatch):

    def fail(*arguments, **options):
        raise OSError("no more disk")

    monkeypatch.setattr(f"raytrace_jax.report.fit_report.folder.{stage}", fail)
    with pytest.raises(RaytraceError, match=rf"{file}: cannot be written: no more disk"):
        fake_result().save(tmp_path)
    written = {path.name for path in tmp_path.iterdir()}
    assert written < set(FILES) and "result.json" in written and len(written) == len(FILES) - absent


@pytest.mark.fast_cases(4)
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("shape", [(3, 4, 40), (3, 40, 4), (3, 1, 1)])
@pytest.mark.parametrize("count", [1, 2, 4, 12])
def test_figure_titles_do_not_overlap(shape, count):
    names = tuple(f"a_rather_long_name_of_a_shape_{i}.center.x" for i in range(count))
    result = full_result(shape=shape, names=names)
    figure = draw_report(result).figure
    shown = [ax for ax in figure.axes if ax.get_visible()]
    titles = [ax.title for ax in shown if ax.get_title()]
    assert len(titles) == 4 + 1 + count + (count > 1) + len(result.profiles)
    above = [text for part in (figure, *figure.subfigs) for text in part.texts]
    assert above[0].get_text() == "ambiguous" and len(above) == 3
    assert [title.get_text()[:4] for title in titles] == [f"({letter}) " for letter in ascii_lowercase[: len(titles)]]
    labels = [label for ax in shown for label in (ax.xaxis.label, ax.yaxis.label) if label.get_text()]
    boxes = [text.get_window_extent() for text in (*above, *titles, *labels)]
    for i, box in enumerate(boxes):
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1 and box.y0 >= 0 and box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_the_ellipse_is_the_covariance_s():
    result = full_result()
    for of_noise, errors in ((False, result.total_error), (True, result.standard_error)):
        outline = ellipse(result, (1, 3), of_noise)
        error = errors[[1, 3]]
        covariance = np.outer(error, error) * result.uncertainty.correlation[np.ix_([1, 3], [1, 3])]
        distance = np.einsum("ip,ij,jp->p", outline, np.linalg.inv(covariance), outline)
        np.testing.assert_allclose(distance, ELLIPSE_95, rtol=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("correlation", [1.0, -1.0, np.nan])
def test_figures_show_degenerate_parameters(correlation):
    result = full_result()
    matrix = np.full((4, 4), correlation)
    np.fill_diagonal(matrix, 1.0)
    error = np.array([0.0, np.inf, 1e-11, 1e5])
    covariance = matrix * np.outer(np.ones(4), np.ones(4))
    result = changed(
        result, check=ModelCheck.nothing(4), uncertainty={"covariance": covariance, "standard_error": error}
    )
    assert len(draw_report(result).cut["ellipses"]) == (not np.isnan(correlation))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("chi_square", [np.full(9, np.nan), np.full(9, np.inf), np.zeros(9), np.linspace(-5, 50, 9)])
@pytest.mark.parametrize("error", [0.0, np.inf, np.nan, 1e-3])
def test_figures_of_odd_profiles(chi_square, error):
    result = full_result()
    result = changed(result, uncertainty={"standard_error": np.full(4, error)})
    profile = dataclasses.replace(result.profiles[0], chi_square=chi_square, interval=(-np.inf, np.inf))
    figure = Figure()
    draw_profile(figure.subplots(), result, profile)
    FigureCanvasAgg(figure).draw()


def test_few_pixels_hold_most_of_the_residual():
    result = fake_result()
    off = np.array(result.target)
    off[:, 3, :5] += 0.5  # Of which one does not count.
    result = dataclasses.replace(result, image=off, weights=np.where(np.arange(40) == 2, 0.0, result.weights))
    assert result.residual_pixels == 4
    remark = facts(result)["rms residual"][1]
    assert remark == "nine tenths of its square in 4 of 1,170 pixels, without blur"
    for image in (None, result.target):
        assert dataclasses.replace(result, image=image).residual_pixels == 0


def test_masked_residuals_set_no_scale():
    result = fake_result()
    image, weights = result.target.copy(), result.weights.copy()
    image[1, 2, 3] -= 4 / 255
    image[0, 5, 6] += 200 / 255
    weights[:, 5, 6] = 0
    residual = residual_of(changed(result, weights=weights, image=image))
    assert residual.picture[2, 3] == pytest.approx(-4) and residual.limit == pytest.approx(4)
    assert residual.picture.mask.sum() == 1 and not residual.extends
    nothing = residual_of(changed(result, weights=np.zeros_like(weights)))
    assert nothing.limit == 1 and nothing.picture.mask.all()


@pytest.mark.parametrize(
    ("value", "error", "short", "long"),
    [
        (1.3370123, 2.3e-4, "1.33701(23)", "1.33701 +- 0.00023"),
        (1.45000000005, 5e-11, "1.450000000050(50)", "1.450000000050 +- 0.000000000050"),
        (4.0, 0.0996, "4.00(10)", "4.00 +- 0.10"),
        (4.2, 2.7, "4.2(2.7)", "4.2 +- 2.7"),
        (12.0, 9.96, "12(10)", "12 +- 10"),
        (-0.001, 0.12, "0.00(12)", "0.00 +- 0.12"),
        (3.0, 27.0, "3(27)", "3 +- 27"),
        (-123.4, 2700.0, "-100(2700)", "-100 +- 2700"),
        (0.4, 99.9, "0(100)", "0 +- 100"),
        (9500.0, 27000.0, "10000(27000)", "10000 +- 27000"),
        (9500.0, 270.0, "9.50(27)e3", "9.50e3 +- 0.27e3"),
        (5e6, 1e6, "5.0(1.0)e6", "5.0e6 +- 1.0e6"),
        (6.02e23, 1e20, "6.0200(10)e23", "6.0200e23 +- 0.0010e23"),
        (1.2345e-7, 1.2e-10, "1.2345(12)e-7", "1.2345e-7 +- 0.0012e-7"),
        (0.0, 1e-7, "0.0(1.0)e-7", "0.0e-7 +- 1.0e-7"),
        (1.5, 0.0, "1.5(0)", "1.5 +- 0"),
        (1.5, 3e-18, "1.5 +- 3e-18", "1.5 +- 3e-18"),
        (1.5, np.inf, "1.5, not determined", "1.5, not determined"),
        (1.5, np.nan, "1.5, error unknown", "1.5, error unknown"),
        (np.nan, 1.0, "nan, error unknown", "nan, error unknown"),
    ],
)
def test_estimates_have_two_forms(value, error, short, long):
    assert (with_error(value, error), with_error(value, error, long=True)) == (short, long)
    if " +- " in long:
        assert value_and_error(value, error) == tuple(long.split(" +- "))


def read_back(text):
    """The value and the error that an estimate's short form says."""
    value, error, power = re.fullmatch(r"(-?[0-9.]+)\(([0-9.]+)\)(e-?[0-9]+)?", text).groups()
    decimals = 0 if "." in error else len(value.partition(".")[2])
    return float(value + (power or "")), float(f"{error}{power or 'e0'}") * 10.0**-decimals


@given(value=st.floats(-1e12, 1e12), error=st.floats(1e-10, 1e12))
def test_an_estimate_s_forms_read_back(value, error):
    short, long = with_error(value, error), with_error(value, error, long=True)
    for read in ([read_back(short)] if "(" in short else []) + [tuple(map(float, long.split(" +- ")))]:
        assert abs(read[0] - value) <= 0.0501 * error + 1e-15 * abs(value)
        assert abs(read[1] - error) <= 0.0501 * error


def test_estimates_in_print():
    assert estimate_line(-1.3370123, 2.3e-4) == "−1.33701(23)"
    assert estimate_line(-1.3370123, 2.3e-4, long=True) == "−1.33701 ± 0.00023"
    assert estimate_line(1.2345e-7, 1.2e-10) == "1.2345(12) × 10⁻⁷"
    assert estimate_line(1.45, np.inf) == "1.45, not determined"
    numbers = {0.0: "0", -1.02134: "−1.02", 12345.0: "12300", 3.2e9: "3.2 × 10⁹", -4.26e-7: "−4.26 × 10⁻⁷"}
    assert {value: number_text(value) for value in numbers} == numbers
    assert (number_text(np.inf), number_text(np.nan)) == ("infinite", "unknown")


def test_tables_to_paste_hold_the_estimates():
    result = full_result(names=("a_1.ior", "b%.center.x", "c{}.radius", "d,\\e.ior"))
    result = changed(result, uncertainty={"standard_error": np.array([2.3e-4, 1.1e-3, np.nan, np.inf])})
    rows = list(csv.DictReader(io.StringIO(csv_table(result))))
    assert [row["parameter"] for row in rows] == list(result.names)
    for column, numbers in (
        *(("value", result.value), ("standard_error", result.standard_error)),
        *(("systematic_error", result.systematic_error), ("total_error", result.total_error)),
    ):
        np.testing.assert_array_equal([float(row[column]) for row in rows], numbers)
    assert rows[0]["estimate"] == "1.33712(28)" and rows[3]["estimate"] == "2.2987, not determined"
    assert next(csv.DictReader(io.StringIO(csv_table(result, long=True))))["estimate"] == "1.33712 +- 0.00028"

    lines = tex_table(result).splitlines()
    cells = [line.removesuffix(r" \\").split(" & ") for line in lines if line.startswith(r"\texttt")]
    assert cells[0] == [r"\texttt{a\_1.ior}", "$1.33712(28)$", "$0.00023$", "$0.00028$", "unit of index"]
    assert [row[0] for row in cells[1:3]] == [r"\texttt{b\%.center.x}", r"\texttt{c\{\}.radius}"]
    assert cells[2][1:-1] == ["$2.30051$, error unknown", "unknown", "unknown"]
    assert cells[3][:-1] == [r"\texttt{d,\textbackslash{}e.ior}", "$2.2987$, not determined", r"$\infty$", r"$\infty$"]
    rules = (r"\begin{tabular}{lrrrl}", r"\toprule", r"\midrule", r"\bottomrule", r"\end{tabular}")
    assert all(lines.count(rule) == 1 for rule in rules)
    assert r"$1.33712 \pm 0.00028$" in tex_table(result, long=True)


def test_the_methods_name_the_works():
    result = dataclasses.replace(full_result(), provenance={"target": "a/photo.exr", "target_sha256": "ab12"})
    paragraph, works = methods_text(result).split("\n\n")
    for words in (
        "vitreous.ior, vitreous.center.x, vitreous.center.y, vitreous.radius were fitted to the picture photo.exr",
        *("80 × 60 pixels, SHA-256 ab12", "“classic”", "Cauchy's loss", "4,640 pixels", "vitreous.radius (2.3 ± 0.05)"),
        *("no blur, level 4", "3 starts", "2.4/255 (given)", "topright.location.x (0.01)", "ended as “ambiguous”"),
        "vitreous.ior = 1.33712(28)",
    ):
        assert words in paragraph, words
    assert "the stated uncertainty of topright.location.x (0.01) and the model errors" in paragraph
    assert "are the same" not in paragraph and "from column" not in paragraph
    assert works.splitlines() == [f"[{k}] {work}" for k, work in enumerate(references(result).values(), start=1)]
    assert set(re.findall(r"\[(\d)\]", paragraph)) == set("1234567")
    assert "1.33700 ± 0.00023" in methods_text(fake_result(), long=True)


def test_the_methods_name_the_views():
    result = two_views()
    text = methods_text(result)
    assert "fitted to the pictures of 2 views (left: 40 × 30 pixels; right/b: 20 × 24 pixels) with" in text
    told = {"target": "a/l.png, b/r.png", "target_sha256": "ab12"}
    named = methods_text(dataclasses.replace(result, provenance=told))
    assert "(left: l.png, 40 × 30 pixels; right/b: r.png, 20 × 24 pixels; SHA-256 ab12) with" in named
    assert "the mean over its area or, in another view, the mean of 8 × 8 samples on a regular grid." in text
    assert "over 1,680 pixels" in text


def test_a_number_for_all_channels_says_so():
    ties = (("film.gain.g", "film.gain.r"), ("film.gain.b", "film.gain.r"), ("a.center.y", "vitreous.ior"))
    result = changed(fake_result(names=("vitreous.ior", "film.gain.r")), ties=ties)
    assert result.labels == ("vitreous.ior", "film.gain")
    assert "film.gain  " in result.summary() and "film.gain = " in methods_text(result)
    assert result["film.gain.r"].value == result.value[1]
