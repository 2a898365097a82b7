"""The pages on models and the gallery: their scenes, their table and their commands; and the command `gallery`."""

import re
import shlex
from itertools import groupby
from types import SimpleNamespace

import numpy as np
import pictures
import pytest
from command_line import run
from PIL import Image
from scenes import DATA

from raytrace_jax import RenderSettings, parse_scene, read_exr, read_picture, render
from raytrace_jax.cli import dispatch, main
from raytrace_jax.scene.checks import scene_warnings
from raytrace_jax.scene.table import BLOCK_TYPES
from raytrace_jax.tracer.level import MODELS
from raytrace_jax.tracer.shading.model import black

DOCS = DATA.parent / "docs"
ENTRIES = pictures.entries()
SCENES = {name.removesuffix(".txt"): text for name, text in pictures.scenes().items()}
QUICK = [name for name in ENTRIES if name not in ("edges.png", "fit_report.png", "located.png")]
"""Pictures whose size a command takes, or which are done at once."""


def models_of(keyword, attribute):
    """The models to which an attribute of such blocks means something."""
    if keyword == "background":
        return [name for name, model in MODELS.items() if model.background is not black]
    attributes = [a for kinds in BLOCK_TYPES.values() for kind in kinds for a in kind.attributes]
    users = [a for a in attributes if (a.value_type, a.name) == ("name", keyword)]
    used = [name for name in MODELS if attribute.is_used_by(name)]
    return [name for name in used if not users or any(user.is_used_by(name) for user in users)]


def table():
    """The lines of the table: for each keyword a line for attributes of the same models."""
    lines = []
    for keyword, kinds in BLOCK_TYPES.items():
        found = {a.name: models_of(keyword, a) for kind in kinds for a in kind.attributes}
        for models, names in groupby(sorted(found, key=lambda name: (-len(found[name]), found[name])), found.get):
            every = len(set(map(tuple, found.values()))) == 1
            cells = ["yes" if model in models else "–" for model in MODELS]
            lines.append(f"| `{keyword}` | {'all' if every else listed(names)} | {' | '.join(cells)} |")
    return lines


def listed(names):
    return ", ".join(f"`{name}`" for name in names)


def test_the_table_of_attributes_is_true():
    page = (DOCS / "models.md").read_text(encoding="utf-8")
    head = f"| block | attributes | {' | '.join(MODELS)} |\n|---|---|{'---|' * len(MODELS)}\n"
    assert head + "\n".join(table()) + "\n\n" in page, "\n".join(table())


def test_model_scenes_have_nothing_unused():
    assert list(SCENES) == list(MODELS)
    for model, text in SCENES.items():
        scene = parse_scene(text)
        assert scene.settings.model == model and not scene_warnings(scene, model) and len(text.splitlines()) <= 40


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_model_pictures_are_of_their_scenes(model):
    shown = read_picture(DOCS / "images" / f"model_{model}.png", transfer="srgb" if model == "physical" else "course")
    image = render(parse_scene(SCENES[model]), RenderSettings(size=(24, 18), samples=6)).image
    blocks = np.clip(shown, 0, 1).reshape(3, 18, 20, 24, 20).mean((2, 4))
    assert np.abs(blocks - np.clip(image, 0, 1)).mean() < 0.02


def test_gallery_pictures_and_commands_exist(monkeypatch):
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert list(ENTRIES) == re.findall(r"\(images/([\w.]+)\)", page) and len(ENTRIES) >= 8
    actions = SimpleNamespace(**{f"run_{name}": lambda command: 0 for name in dispatch.COMMANDS})
    monkeypatch.setattr(dispatch, "_check_files", lambda command: None)
    monkeypatch.setattr(dispatch.importlib, "import_module", lambda name, package: actions)
    for name, (language, text) in ENTRIES.items():
        assert (DOCS / "images" / name).is_file()
        for line in text.replace("\\\n", " ").splitlines() if language == "sh" else ():
            program, *arguments = shlex.split(line)
            if program == "raytrace-jax":
                assert main(arguments) == 0, line
            else:
                assert program == "python" and (DATA.parent / arguments[0]).is_file(), line


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_the_commands_make_the_pictures(name, tmp_path):
    language, text = ENTRIES[name]
    small = re.sub(r"--size \d+ \d+", "--size 24 18", re.sub(r"size=\(\d+, \d+\)", "size=(24, 18)", text))
    small = re.sub(r"^(raytrace-jax gallery .*)$", r"\1 --size 24 18", small, flags=re.MULTILINE)
    small = re.sub(r":\d+ --", ":3 --", small)
    pictures.prepare(tmp_path)
    assert pictures.make(name, language, small, tmp_path).stat().st_size > 100


@pytest.mark.slow
def test_pictures_come_with_derivatives(tmp_path, capsys):
    small = ["--size", 16, 12, "--max-bounces", 1]
    assert run("gallery", DATA / "vitreous.txt", "-o", tmp_path, *small, "--wrt", "cyan.ior") == 0
    captured = capsys.readouterr()
    written = captured.out.split()
    assert len(written) == 13 and written[-1].endswith("gallery.png")
    assert captured.err.count("took") == 6
    final = read_exr(tmp_path / "6_final_schlick.exr")
    assert {"R", "d.cyan.ior.G"} <= set(final.channels) and np.abs(final.channels["d.cyan.ior.G"]).max() > 0
    picture = read_picture(tmp_path / "6_final_schlick.png", transfer="course")
    np.testing.assert_allclose(picture[0], final.channels["R"], atol=1 / 255)
    with Image.open(tmp_path / "gallery.png") as sheet:
        assert sheet.width > 1000


@pytest.mark.slow
def test_the_glass_gallery_has_six_scenes(tmp_path, capsys):
    assert run("gallery", "--set", "glass", "-o", str(tmp_path), "--size", "16", "12", "--samples", "1", "--quiet") == 0
    written = capsys.readouterr().out.split()
    assert len(written) == 13
    pictures = [read_picture(path) for path in written if path.endswith(".exr")]
    assert len({picture.tobytes() for picture in pictures}) == 6
    assert run("gallery", "vitreous", "--set", "glass", "-o", str(tmp_path)) == 2
    assert "have scenes of their own" in capsys.readouterr().err
