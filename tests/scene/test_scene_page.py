"""The page on scenes: its tables are the table of blocks, and its examples work."""

import math
import re

import pytest
from command_line import run
from scenes import DATA, assert_same_scene

from raytrace_jax import parse_scene
from raytrace_jax.scene.table import BLOCK_TYPES
from raytrace_jax.tracer.settings import MODEL_RULES, ResolvedSettings

PAGE = (DATA.parent / "docs" / "scenes.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"```\n(settings .*?)```", PAGE, re.DOTALL)


def rows(kind):
    """The lines of a kind's table; of a variant of the first kind those that are not alike."""
    first = BLOCK_TYPES[kind.keyword][0]
    is_variant = kind is not first and issubclass(kind.struct, first.struct)
    lines = ["| attribute | values | limits | default |", "|---|---|---|---|"]
    lines += [row(attribute) for attribute in kind.attributes if not (is_variant and attribute in first.attributes)]
    return [line.replace("|  |", "| |") for line in lines]


def row(attribute):
    values = attribute.describe().removeprefix(f"{attribute.name} takes ").removeprefix(f"{attribute.name} is ")
    limit = attribute.limit.wanted if attribute.limit else ""
    return f"| `{attribute.name}` | {values} | {limit} | {attribute.default_words} |"


def test_missing_settings_are_the_models_own():
    (kind,) = BLOCK_TYPES["settings"]
    without = {attribute.name: attribute.without for attribute in kind.attributes}
    classic, additive, physical = (MODEL_RULES[model] for model in ("classic", "additive", "physical"))
    assert classic.mapping == additive.mapping and additive.path_limit == physical.path_limit == math.inf
    assert without == {
        "model": ResolvedSettings().model,
        "mapping": f"{classic.mapping}, {physical.mapping} (physical)",
        "max_bounces": f"{classic.max_bounces}, {additive.max_bounces} (additive), {physical.max_bounces} (physical)",
        "edges": "point, of derivatives aware",
        "samples": f"{ResolvedSettings().samples}",
        "path_limit": f"{classic.path_limit:g} (classic), else no limit",
        "least_weight": f"{physical.least_weight:g} (physical only)",
        "reflectance": f"{ResolvedSettings().reflectance} (classic only)",
        "eta": f"{ResolvedSettings().eta} (classic only)",
    }


def test_unused_settings_have_no_choice():
    (kind,) = BLOCK_TYPES["settings"]
    for model, rules in MODEL_RULES.items():
        unused = {attribute.name for attribute in kind.attributes if not attribute.is_used_by(model)}
        assert unused == rules.only.keys() & {attribute.name for attribute in kind.attributes}


@pytest.mark.parametrize("kind", [kind for kinds in BLOCK_TYPES.values() for kind in kinds])
def test_every_kind_of_block_has_its_table(kind):
    _, _, section = PAGE.partition(f"\n### `{kind.keyword} NAME {{ ... }}`")
    assert "\n".join(rows(kind)) + "\n" in section.partition("\n### ")[0]


def test_the_commands_take_the_example(tmp_path, capsys):
    path = tmp_path / "lab.txt"
    path.write_text(EXAMPLE)
    assert run("info", str(path)) == 0
    told = capsys.readouterr().out
    for line in (
        "camera eye pixeldim 64 48",
        "rectangle backdrop material board",
        "eye.fov 40",
        "backdrop.right 6,0,0",
    ):
        assert line in " ".join(told.split())
    assert run("format", str(path), "-D", "backdrop.center.z=-3", "-D", "eye.fov=50", "-D", "ball.ior=1.4") == 0
    changed = parse_scene(capsys.readouterr().out)
    wanted = {"backdrop.center.z": -3, "eye.fov": 50, "crown.ior": 1.4}
    assert {name: float(changed[name]) for name in wanted} == pytest.approx(wanted)


def test_there_is_no_other_table():
    assert PAGE.count("| attribute |") == sum(map(len, BLOCK_TYPES.values()))
    assert re.findall(r"^### `(\w+) NAME", PAGE, re.MULTILINE) == list(BLOCK_TYPES)


def test_file_and_python_examples_agree():
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names = {}
    exec(program, names)
    assert_same_scene(names["scene"], parse_scene(EXAMPLE))
