"""The report of a fit: its files hold what the result holds, whole or not at all."""

import dataclasses
import json

import hypothesis.strategies as st
import numpy as np
import pytest
from fake_fit import fake_result
from hypothesis import given
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

import raytrace_jax
from raytrace_jax._estimates import value_and_error
from raytrace_jax._report_figure import draw_report
from raytrace_jax.errors import RaytraceError
from raytrace_jax.exr import read_exr
from raytrace_jax.modelfile import format_scene
from raytrace_jax.report import write_fit

FILES = ["fit.exr", "fit.txt", "report.png", "residual.exr", "result.json"]


def refuse_constant(name):
    raise AssertionError(f"{name} is not JSON")


def test_the_files_hold_the_result(tmp_path):
    result = fake_result()
    folder = tmp_path / "new" / "fit"
    write_fit(result, folder)
    assert sorted(path.name for path in folder.iterdir()) == FILES

    summary = json.loads((folder / "result.json").read_text(), parse_constant=refuse_constant)
    assert summary["status"] == "converged" and summary["message"] == result.message
    assert summary["parameters"]["vitreous.ior"] == {"value": 1.337, "initial": 1.5, "standard_error": 2.3e-4}
    assert summary["parameters"]["vitreous.radius"]["standard_error"] is None
    assert summary["correlation"] == {"names": list(result.names), "matrix": [[1.0, None], [None, 1.0]]}
    assert summary["rms_residual"] == result.rms_residual
    for entry, step in zip(summary["history"], result.history, strict=True):
        assert entry == {**dataclasses.asdict(step), "value": step.value.tolist()}
    assert summary["settings"]["size"] == [40, 30]
    assert summary["versions"]["raytrace_jax"] == raytrace_jax.__version__
    assert set(summary["versions"]) > {"jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "python"}
    assert summary["scene"] == (folder / "fit.txt").read_text() == format_scene(result.scene)

    for name, image in (("fit.exr", result.image), ("residual.exr", result.image - result.target)):
        picture = read_exr(folder / name)
        stored = np.stack([picture.channels[channel] for channel in "RGB"])
        np.testing.assert_array_equal(stored, image.astype(np.float32))
        assert picture.metadata["scene"] == summary["scene"]
    with Image.open(folder / "report.png") as figure:
        assert figure.width == 1800


def test_a_failure_leaves_the_old_files_and_no_new_result(tmp_path):
    write_fit(fake_result(), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    broken = dataclasses.replace(fake_result(), image=np.full((3, 30, 40), np.nan))
    with pytest.raises(RaytraceError, match="NaN"):
        write_fit(broken, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_result_json_comes_last(tmp_path, monkeypatch):
    """Whoever finds it may rely on the other files."""

    def fail(result):
        raise OSError("no more disk")

    monkeypatch.setattr("raytrace_jax.report.draw_report", fail)
    with pytest.raises(RaytraceError, match=r"report\.png: cannot be written: no more disk"):
        write_fit(fake_result(), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.exr", "fit.txt", "residual.exr"]


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RaytraceError, match="is not a folder"):
        write_fit(fake_result(), tmp_path / "file")


@pytest.mark.parametrize("shape", [(3, 4, 40), (3, 40, 4), (3, 1, 1)])
@pytest.mark.parametrize("count", [1, 12])
def test_figure_titles_do_not_overlap(shape, count):
    names = tuple(f"a_rather_long_name_of_a_shape_{i}.center.x" for i in range(count))
    figure = draw_report(fake_result(shape=shape, names=names))
    FigureCanvasAgg(figure).draw()
    boxes = [
        ax.title.get_window_extent()
        for part in figure.subfigs
        for ax in part.axes
        if ax.get_visible() and ax.get_title()
    ]
    assert len(boxes) == 4 + 1 + count
    for i, box in enumerate(boxes):
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1
        assert not any(box.overlaps(other) for other in boxes[:i])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("steps", [0, 1])
def test_figure_of_a_fit_that_was_stopped_at_once(steps):
    result = fake_result(status="interrupted")
    figure = draw_report(dataclasses.replace(result, history=result.history[:steps], image=result.target))
    FigureCanvasAgg(figure).draw()


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (1.3370123, 2.3e-4, ("1.33701", "0.00023")),
        (4.0, 0.0996, ("4.00", "0.10")),
        (-123.4, 27.0, ("-123", "27")),
        (-123.4, 2700.0, ("-123", "2700")),
        (1.5, np.inf, ("1.5", "inf")),
        (1.5, np.nan, ("1.5", "nan")),
        (1.5, 0.0, ("1.5", "0")),
        (1.5, 3e-15, ("1.5", "3e-15")),
    ],
)
def test_value_and_error(value, error, expected):
    assert value_and_error(value, error) == expected


@given(value=st.floats(-1e6, 1e6), error=st.floats(1e-10, 1e5))
def test_the_written_value_is_within_a_tenth_of_its_error(value, error):
    text, error_text = value_and_error(value, error)
    assert abs(float(text) - value) <= 0.0501 * error + 1e-9 * abs(value) * (error < 1e-9) or error > 10
    assert abs(float(error_text) - error) <= 0.0501 * error
