"""The command `rays`: a drawing, a table, and names of any kind."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from PIL import Image

from raytrace_jax import RenderSettings, load_scene, set_parameters
from raytrace_jax.tracer.ray_tree import trace_tree

VITREOUS = Path(__file__).parent.parent / "data" / "vitreous.txt"
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
    assert all(f"<!-- {word} -->" in text for word in ("reflected", "transmitted", "vitreous"))
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
def test_rays_through_glass_have_a_medium_and_what_it_absorbs(tmp_path, capsys):
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
