"""Comments in scene files: what they do not change, and that the canonical form keeps them in place."""

from pathlib import Path

import pytest
from command_line import run
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import assert_same_scene

from raytrace_jax import format_scene, parse_scene

COMMENTED = """\
# A glass ball before nothing.
// By hand.

# as glass
settings main { model physical } # not the course's
# the eye
camera eye { # a pinhole
  pixeldim 8 6 viewpoint 0 0 5   // from the front
  lookat 0 0 0
  # narrow
  fov 40 # degrees
  # up is up
}
sphere ball { material fov center 0 0 0 radius 1 } // the ball
// BK7, nearly
material fov { transmission 1
 ior 1.5 # the default
 emission 0 0 0 // dark
 # no mirror
}
# THE END
"""

CANONICAL = """\
# A glass ball before nothing.
// By hand.

# as glass
settings main {
    model physical
}  # not the course's

# the eye
camera eye {  # a pinhole
    pixeldim 8 6
    viewpoint 0 0 5  // from the front
    lookat 0 0 0
    # narrow
    fov 40  # degrees
    # up is up
}

// BK7, nearly
material fov {
    ior 1.5  # the default
    transmission 1
    emission 0 0 0  // dark
    # no mirror
}

sphere ball {
    material fov
    center 0 0 0
    radius 1
}  // the ball

# THE END
"""


def test_the_canonical_form_keeps_comments():
    text = format_scene(parse_scene(COMMENTED), comments=COMMENTED)
    assert text == CANONICAL
    assert format_scene(parse_scene(text), comments=text) == text


def test_a_changed_value_keeps_comments(tmp_path, capsys):
    path = tmp_path / "ball.txt"
    path.write_text("\ufeff" + COMMENTED.replace("\n", "\r\n"), encoding="utf-8", newline="")
    assert run("format", str(path), "-D", "fov.ior=1.7") == 0
    assert capsys.readouterr().out == CANONICAL.replace("ior 1.5", "ior 1.7")


@settings(max_examples=25)
@given(st.data())
def test_comments_change_nothing(data):
    words = parse_scene(COMMENTED), CANONICAL.split("\n")
    scene, lines = words
    bare = [line.split("#")[0].split("//")[0].rstrip() for line in lines]
    added = [f"{data.draw(st.sampled_from(['#', '//']))} {number}!" for number in range(len(bare))]
    beside = [data.draw(st.booleans()) and bool(line) for line in bare]
    pairs = zip(bare, added, beside, strict=True)
    text = "\n".join(f"{line} {comment}" if is_beside else f"{comment}\n{line}" for line, comment, is_beside in pairs)
    again = parse_scene(text)
    assert_same_scene(again, scene)
    kept = format_scene(again, comments=text)
    assert all(kept.count(f" {number}!") == 1 for number in range(len(bare)))
    assert format_scene(parse_scene(kept), comments=kept) == kept


@pytest.mark.parametrize("name", ["vitreous.txt", "checkpoints.txt"])
def test_canonical_glass_states_its_index(name):
    text = (Path(__file__).parents[2] / "data" / name).read_text()
    scene = parse_scene(text, model="additive")
    materials = [block for block in format_scene(scene, model="additive").split("\n\n") if block.startswith("material")]
    assert materials
    for block in materials:
        is_glass = any(f"{word} " in block for word in ("alpha", "transmission"))
        assert is_glass <= ("ior" in block)
