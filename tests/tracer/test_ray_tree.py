"""The tree of rays of one pixel: its root is the rendered pixel, its rays obey the laws; and the command `rays`."""

import dataclasses
import json
import re

import numpy as np
import pytest
from command_line import run
from PIL import Image
from scenes import DATA, assignment_scene

from raytrace_jax import RaytraceError, RenderSettings, load_scene, parse_scene, render, set_parameters
from raytrace_jax.optics import AIR_IOR
from raytrace_jax.report.rays import draw_tree
from raytrace_jax.tracer.ray_tree import trace_tree
from raytrace_jax.tracer.settings import ResolvedSettings

SIZE = (40, 30)
SETTINGS = ResolvedSettings(size=SIZE)
EMPTY = "camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 }"


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(
    "switches",
    [{}, pytest.param({"total_internal_reflection": False, "reflectance": "none"}, marks=pytest.mark.slow)],
    ids=lambda switches: " ".join(f"{name}={value}" for name, value in switches.items()),
)
def test_the_first_ray_has_the_pixels_colour(switches):
    settings = dataclasses.replace(SETTINGS, **switches)
    scene = assignment_scene()
    image = np.asarray(render(scene, settings).image)
    totals, errors = 0, []
    for row in range(1, SIZE[1], 5):
        for column in range(1, SIZE[0] - 1, 3):  # Rounding decides the first and the last column.
            tree = trace_tree(scene, (column, row), settings)
            errors.append(np.abs(tree.nodes[0].color - image[:, row, column]).max())
            totals += sum(node.total for node in tree.nodes)
    # Bounces within the glass magnify how differently two programs round: of the 1140 pixels, one to 1.2e-12.
    assert np.mean(np.asarray(errors) < 1e-12) > 0.98 and max(errors) < 1e-10
    if settings.max_bounces != 0:
        assert totals > 10


@pytest.mark.slow
def test_the_additive_model():
    scene = load_scene(DATA / "checkpoints.txt", model="additive")
    settings = ResolvedSettings(size=SIZE, model="additive", max_bounces=3)
    image = np.asarray(render(scene, settings).image)
    kinds = set()
    for column, row in [(22, 24), (24, 22), (20, 25), (10, 23), (30, 24), (5, 5)]:
        tree = trace_tree(scene, (column, row), settings)
        np.testing.assert_allclose(tree.nodes[0].color, image[:, row, column], rtol=0, atol=1e-12)
        kinds |= {(node.kind, node.shape) for node in tree.nodes}
    assert {("transmitted", "lens"), ("reflected", "ground")} <= kinds


def test_rays_follow_from_their_parents():
    scene = assignment_scene()
    kinds = set()
    for pixel in [(20, 15), (14, 12), (26, 20), (9, 16), (30, 8)]:
        tree = trace_tree(scene, pixel, SETTINGS)
        root, *others = tree.nodes
        assert (root.number, root.parent, root.kind, root.weight) == (0, None, "camera", 1)
        np.testing.assert_array_equal(root.o, scene.camera.viewpoint)
        for number, node in enumerate(others, start=1):
            assert node.number == number and node.parent < number
            parent = tree.nodes[node.parent]
            assert node.bounce == parent.bounce + 1 <= SETTINGS.max_bounces
            np.testing.assert_array_equal(node.o, parent.p)
            share = {"reflected": parent.reflect, "transmitted": parent.transmit}[node.kind]
            assert 0 < share <= 1 and node.weight == parent.weight * share
            cos_i, cos_out = -parent.d @ parent.n, -node.d @ parent.n
            if node.kind == "reflected":
                assert cos_out == pytest.approx(-cos_i, abs=1e-9)  # Normals have length one to that.
            else:
                sign = 1 if parent.entering else -1
                assert cos_out == pytest.approx(sign * np.cos(parent.theta_t), abs=1e-9)
            if node.shape is not None:
                np.testing.assert_allclose(node.o + node.distance * node.d, node.p, atol=1e-12)
                assert node.path_length == pytest.approx(parent.path_length + node.distance)
            kinds.add(node.kind)
        for node in tree.nodes:
            if node.shape is not None:
                assert np.cos(node.theta_i) == pytest.approx(abs(node.d @ node.n), abs=1e-12)
            if node.theta_t is not None:
                ior = float(scene.materials.ior[scene.materials.names.index("cyan")])
                eta = ior / AIR_IOR if node.entering else 1 / (ior * AIR_IOR)
                assert node.shape == "vitreous" and not node.total
                assert np.sin(node.theta_i) == pytest.approx(eta * np.sin(node.theta_t), abs=1e-9)
            if node.total:
                assert node.shape == "vitreous" and node.transmit == 0 and not node.entering
    assert kinds == {"reflected", "transmitted"}


def test_rays_cut_by_the_limit_are_counted():
    scene = assignment_scene()
    whole = trace_tree(scene, (20, 15), SETTINGS)
    for bounces in range(3):
        cut = trace_tree(scene, (20, 15), dataclasses.replace(SETTINGS, max_bounces=bounces))
        assert cut.dropped == sum(node.bounce == bounces + 1 for node in whole.nodes) > 0
        assert [node.shape for node in cut.nodes] == [node.shape for node in whole.nodes if node.bounce <= bounces]


def test_an_empty_scene_is_one_black_ray():
    [node] = trace_tree(parse_scene(EMPTY), (0, 0)).nodes
    assert node.shape is None and not node.color.any()


@pytest.mark.slow
def test_rays_get_room_or_are_refused():
    half = "specular 0.5 0.5 0.5 ambient 1 1 1 alpha 0.5 ior 1.5"
    walls = "".join(
        f"plane p{i} {{ material glass normal 0 0 1 point 0 0 {-i - 1} }} " for i in range(6)
    )  # Parallel sheets of glass: each ray becomes two until it leaves.
    scene = parse_scene(f"{EMPTY} material glass {{ {half} }} {walls}")
    settings = ResolvedSettings(size=(5, 5), max_bounces=8)
    tree = trace_tree(scene, (2, 2), settings)
    widest = max(sum(node.bounce == bounce for node in tree.nodes) for bounce in range(9))
    assert widest > 64
    expected = np.asarray(render(scene, settings).image)[:, 2, 2]
    np.testing.assert_allclose(tree.nodes[0].color, expected, rtol=0, atol=1e-12)
    with pytest.raises(RaytraceError, match="more than 8192 rays; allow fewer"):
        trace_tree(scene, (2, 2), dataclasses.replace(settings, max_bounces=20))


@pytest.mark.parametrize(
    ("pixel", "switches", "words"),
    [
        ((40, 0), {}, "pixel 40 0 .* columns are 0 to 39, rows are 0 to 29"),
        ((0, -1), {}, "pixel 0 -1"),
        ((0, 0), {"samples": 2}, "samples is 2"),
        ((0, 0), {"edges": "aware"}, "edges is 'aware'"),
        ((0, 0), {"crop": (30, 0, 20, 20)}, "crop"),
    ],
)
def test_what_is_not_one_ray_is_refused(pixel, switches, words):
    with pytest.raises(ValueError, match=words):
        trace_tree(assignment_scene(), pixel, dataclasses.replace(SETTINGS, **switches))


def test_drawn_names_stay_within_the_frame():
    scene = assignment_scene()
    for pixel in ((20, 15), (34, 9), (5, 25)):
        figure = draw_tree(trace_tree(scene, pixel, SETTINGS), scene)
        figure.draw_without_rendering()
        [ax] = figure.axes
        names = [text for text in ax.texts if text.get_style() == "italic" and text.get_visible()]
        assert names
        for box in (text.get_window_extent() for text in names):
            assert ax.bbox.x0 <= box.x0 <= box.x1 <= ax.bbox.x1 and ax.bbox.y0 <= box.y0 <= box.y1 <= ax.bbox.y1


VITREOUS = DATA / "vitreous.txt"
TWO_BALLS = """camera eye {{ pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 }} material glass {{ alpha 0.5 ior 1.5 }}
sphere {} {{ material glass center 0 0 -3 radius 1 }} sphere {} {{ material glass center 3 0 -3 radius 1 }}"""


@pytest.mark.parametrize("suffix", [".svg", ".png"])
def test_rays_draws_the_tree_and_lists_it(suffix, tmp_path, capsys):
    out = tmp_path / "new" / f"tree{suffix}"
    options = ["--size", 40, 30, "--max-bounces", 3, "-D", "vitreous.ior=1.5"]
    assert run("rays", VITREOUS, "--pixel", 20, 15, "-o", out, *options) == 0
    captured = capsys.readouterr()
    scene = set_parameters(load_scene(VITREOUS), {"vitreous.ior": 1.5})
    tree = trace_tree(scene, (20, 15), RenderSettings(size=(40, 30), max_bounces=3))
    path, title, headers, *lines = captured.out.splitlines()
    assert path == str(out) and "degrees" in title and headers.split()[0] == "ray"
    assert len(lines) == len(tree.nodes) > 5
    for line, node in zip(lines, tree.nodes, strict=True):
        number, parent, kind, shape, *cells = line.split()
        assert (number, parent) == (str(node.number), "-" if node.parent is None else str(node.parent))
        assert (kind, shape) == (node.kind, node.shape or "nothing")
        np.testing.assert_allclose([float(cell) for cell in cells[-3:]], node.color, atol=5e-5)
        if node.theta_t is not None:
            np.testing.assert_allclose(float(cells[3]), np.degrees(node.theta_t), atol=5e-3)
    assert f"{tree.dropped} rays beyond --max-bounces 3" in captured.err
    if suffix == ".png":
        with Image.open(out) as drawing:
            colors = {color for _, color in drawing.convert("RGB").getcolors(1 << 24)}
            assert min(drawing.size) > 300 and len(colors) > 20
        return
    text = out.read_text()
    assert all(
        f"<!-- {word} -->" in text for word in ("reflected", "transmitted", "vitreous, n = 1.5", "normal of a surface")
    )
    # The axes are directions in words; the angles of the first hit are written.
    angles = (f"{np.degrees(angle):.1f}°" for angle in (tree.nodes[0].theta_i, tree.nodes[0].theta_t))
    assert all(f"<!-- {words} -->" in text for words in (*angles, "away from the camera [world units]"))
    assert run("rays", VITREOUS, "--pixel", 20, 15, "-o", out, *options, "--quiet") == 0
    assert capsys.readouterr().err == ""
    assert sorted(path.name for path in out.parent.iterdir()) == [out.name]


def test_rays_draws_names_of_any_kind(tmp_path, capsys):
    path = tmp_path / "a$b^$ \u6f22.txt"
    path.write_text(TWO_BALLS.format("$x^$\\frac\u6f22", "y" * 300), encoding="utf-8")
    assert run("rays", path, "--pixel", 1, 1, "-o", tmp_path / "a.png", "--size", 4, 3) == 0
    assert "error" not in capsys.readouterr().err
    with Image.open(tmp_path / "a.png") as drawing:
        assert drawing.width < 2500


@pytest.mark.slow
def test_rays_in_glass_have_their_medium(tmp_path, capsys):
    assert run("rays", "bubble", "--pixel", "360", "220", "-o", str(tmp_path / "a.png"), "--json") == 0
    captured = capsys.readouterr()
    rays = json.loads(captured.out)["rays"]
    absorption = np.asarray(load_scene("bubble")["glass.absorption"])
    media = {ray["medium"] for ray in rays}
    assert media == {None, "glass", "bubble"} and len(rays) > 20
    for ray in rays:
        expected = 1 - np.exp(-absorption * ray["distance"]).mean() if ray["medium"] == "glass" else 0
        assert ray["absorbed"] == pytest.approx(expected, abs=1e-12)
    drawn = sum(ray["weight"] >= 0.005 for ray in rays)
    assert f"{drawn} of {len(rays)} rays are drawn" in captured.err and drawn < len(rays)
    assert run("rays", "bubble", "--pixel", "360", "220", "-o", str(tmp_path / "b.png"), "--least-drawn", "0") == 0
    captured = capsys.readouterr()
    assert "are drawn" not in captured.err and re.search("medium +absorbed +color", captured.out)
    assert run("rays", "bubble", "--pixel", "1", "1", "-o", str(tmp_path / "c.png"), "--least-drawn", "2") == 2
    assert "--least-drawn is 2.0; wanted a share from 0 to below 1." in capsys.readouterr().err
