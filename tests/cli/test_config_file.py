"""Options of a command from a TOML file."""

import pytest
from command_line import run

from raytrace_jax.cli.dispatch import with_config

TEXT = """
free = ["glass.ior", "glass.center"]
search = false
max_steps = 80
size = [16, 12]
output = "out"
[define]
"glass.ior" = 1.5
"glass.center" = [0, 0.5, -1]
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text(TEXT)
    return path


def test_entries_are_options(file):
    given = ["fit", "a.txt", "b.exr"]
    assert with_config([*given, f"--config={file}"]) == with_config([*given, "--config", str(file)])
    assert with_config([*given, "--config", str(file)]) == [
        *("fit", "a.txt", "b.exr", "--free", "glass.ior", "glass.center", "--no-search", "--max-steps", "80"),
        *("--size", "16", "12", "--output", "out", "--define", "glass.ior=1.5", "glass.center=0,0.5,-1"),
    ]


def test_the_command_line_overrides_the_file(file):
    free = ["glass.ior", "glass.center"]
    given = ["fit", "--search", "-o", "here", "--size", "8", "6", "-D", "glass.ior=2"]
    assert with_config([*given, "--config", str(file)]) == [*given, "--free", *free, "--max-steps", "80"]
    assert with_config(given) == given
    given = ["fit", "--max-steps=3", "-Dglass.ior=2", "--no-search", "--size", "8", "6", "--output=a"]
    assert with_config([*given, "--config", str(file)]) == [*given, "--free", *free]


def test_a_command_obeys_it(tmp_path, capsys):
    (tmp_path / "a.toml").write_text(
        f'output = "{tmp_path}/a.exr"\nsize = [8, 6]\nmax-bounces = 1\npng = false\nquiet = true'
    )
    assert run("render", "vitreous", "--config", str(tmp_path / "a.toml")) == 0
    assert capsys.readouterr().out == f"{tmp_path}/a.exr\n"


def test_the_command_says_what_is_wrong(tmp_path, capsys):
    assert run("render", "vitreous", "--config") == 2
    assert run("render", "vitreous", "--config", str(tmp_path / "none.toml")) == 1
    path = tmp_path / "a.toml"
    for text, code in {b"colour = 1": 2, b"samples = 0": 2, b"free = [": 1, b"\xff": 1}.items():
        path.write_bytes(text)
        assert run("render", "vitreous", "-o", "a.exr", "--config", path) == code
    told = capsys.readouterr().err
    assert told.count("is not TOML") == 2 and "not UTF-8" in told
    assert "--samples is 0; wanted a whole number from 1 to 64." in told
    assert "takes one file" in told and "none.toml" in told
    assert "Unrecognized options: --colour" in told
