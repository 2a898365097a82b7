"""Options of a command from a TOML file."""

import pytest
from command_line import run

from raytrace_jax import RaytraceError
from raytrace_jax.cli.console import UsageError
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
    assert with_config(["fit", "a.txt", "b.exr", "--config", str(file)]) == [
        *("fit", "a.txt", "b.exr", "--free", "glass.ior", "glass.center", "--no-search", "--max-steps", "80"),
        *("--size", "16", "12", "--output", "out", "--define", "glass.ior=1.5", "--define", "glass.center=0,0.5,-1"),
    ]


def test_the_command_line_overrides_the_file(file):
    given = ["fit", "--search", "-o", "here", "--size", "8", "6", "-D", "glass.ior=2"]
    assert with_config([*given, "--config", str(file)]) == [
        *given,
        "--free",
        "glass.ior",
        "glass.center",
        "--max-steps",
        "80",
    ]
    assert with_config(given) == given
    given = ["fit", "--max-steps=3", "-Dglass.ior=2", "--no-search", "--size", "8", "6", "--output=a"]
    assert with_config([*given, "--config", str(file)]) == [*given, "--free", "glass.ior", "glass.center"]


def test_a_command_obeys_it(tmp_path, capsys):
    (tmp_path / "a.toml").write_text(
        f'output = "{tmp_path}/a.exr"\nsize = [8, 6]\nmax-bounces = 1\npng = false\nquiet = true'
    )
    assert run("render", "vitreous", "--config", str(tmp_path / "a.toml")) == 0
    assert capsys.readouterr().out == f"{tmp_path}/a.exr\n"


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("free = [", RaytraceError, "no TOML"),
        ("free = [[1]]", UsageError, "free is"),
        ("sigma = 2020-01-01", UsageError, "sigma is"),
    ],
)
def test_what_no_option_can_be_is_refused(tmp_path, text, error, words):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(error, match=words):
        with_config(["fit", "--config", str(path)])


def test_the_command_says_what_is_wrong(tmp_path, capsys):
    assert run("render", "vitreous", "--config") == 2
    assert run("render", "vitreous", "--config", str(tmp_path / "none.toml")) == 1
    path = tmp_path / "a.toml"
    path.write_text("colour = 1")
    assert run("render", "vitreous", "-o", "a.exr", "--config", str(path)) == 2
    told = capsys.readouterr().err
    assert "takes one file" in told and "none.toml" in told
    assert f"error: {path}: colour: render has no such option. There are output, define, half" in told


def test_a_value_out_of_bounds_is_told_with_the_file_that_has_it(tmp_path, capsys):
    path = tmp_path / "a.toml"
    path.write_text("samples = 0\nmax_bounces = 0")
    given = ("render", "vitreous", "-o", "a.exr", "--config", path)
    assert run(*given) == run(*given, "--samples", "2", "--max-bounces=-1") == 2
    assert capsys.readouterr().err.splitlines() == [
        f"error: {path}: --samples is 0; wanted a whole number from 1 to 64.",
        "error: --max-bounces is -1; wanted a whole number from 0 to 64.",
    ]
