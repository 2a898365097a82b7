"""The command `glass`: its tables, and what it says of bad input."""

import pytest
from command_line import run

from raytrace_jax.optics import glass


def test_an_index_lists_glasses(capsys):
    assert run("glass", "1.5168+-0.0003", "--abbe", "64.17+-0.5") == 0
    title, head, first, *_ = capsys.readouterr().out.splitlines()
    assert title.endswith("within 3 errors") and head.split()[:5] == ["maker", "name", "n_d", "V_d", "errors"]
    assert "N-BK7" in first and "HOYA BSC7" in first and "1.51680  64.17" in first


def test_a_name_prints_what_a_scene_wants(capsys):
    assert run("glass", "schott n-bk7") == 0
    text = capsys.readouterr().out
    assert 'glass "SCHOTT N-BK7"\nior 1.515909 1.518522 1.524012\nior 1.516800 abbe 64.17\n' in text
    assert float(glass.named("N-BK7").index(465.0)) == pytest.approx(1.524012, abs=5e-7)


def test_a_common_name_says_which_entry_and_ray_it_is(capsys):
    assert run("glass", "sapphire") == 0
    text = capsys.readouterr().out
    assert "Malitson-o Al2O3, V_d = 72.31, birefringent: the ordinary ray" in text
    assert 'glass "Malitson-o Al2O3"' in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "an index with its error is wanted"),
        (["1.5"], "1.5168+-0.0003"),
        (["0.5+-0.1"], "index is 0.5; 1 or more"),
        (["1.5+-0"], "error is 0.0"),
        (["1.5+-0.1", "--abbe", "64"], "64+-2"),
        (["N-BK8"], "Did you mean 'N-BK7'"),
        (["N-BK7", "--kind", "glass"], "go with an index"),
    ],
)
def test_bad_input(capsys, arguments, words):
    assert run("glass", *arguments) == 2
    assert words in capsys.readouterr().err
