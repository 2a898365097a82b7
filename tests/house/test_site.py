"""The pages of the site: what MkDocs needs is there, links lead somewhere, and the code of pages runs."""

import re
from pathlib import Path
from types import ModuleType

import blocks
import pytest
import yaml

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
NOTEBOOKS = {f"notebooks/{path.stem}.md" for path in (ROOT / "experiments" / "teaching").glob("*.ipynb")}
MADE = {"index.md", "commands.md", "contributing.md", "changelog.md"} | NOTEBOOKS
"""Pages that `docs/hooks/pages.py` makes when the site is built."""

LINK = re.compile(r"\]\(([^)\s]+)\)")


SETTINGS = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))


def pages_of(nav):
    if isinstance(nav, str):
        return [nav]
    return [page for part in (nav.values() if isinstance(nav, dict) else nav) for page in pages_of(part)]


def test_the_navigation_has_every_page_once():
    pages = pages_of(SETTINGS["nav"])
    assert len(pages) == len(set(pages))
    assert set(pages) == {path.relative_to(DOCS).as_posix() for path in PAGES} | MADE
    assert not any((DOCS / name).exists() for name in MADE)
    assert all((ROOT / hook).is_file() for hook in SETTINGS["hooks"])
    assert all((DOCS / style).is_file() for style in SETTINGS["extra_css"])
    assert SETTINGS["theme"]["font"] is False and "analytics" not in SETTINGS["extra"]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_relative_links_lead_to_files(path):
    text = re.sub(r"^ *```.*?^ *```$|`[^`\n]+`", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target in LINK.findall(text):
        if re.match(r"[a-z][a-z+.-]*:|#", target):
            continue
        place = (path.parent / target.partition("#")[0]).resolve()
        assert place.exists() and place.is_relative_to(ROOT), target


def test_every_public_name_is_documented():
    import raytrace_jax

    page = (DOCS / "api.md").read_text(encoding="utf-8")
    shown = re.findall(r"^::: raytrace_jax\.(\w+)$", page, re.MULTILINE)
    shown += " ".join(re.findall(r"^::: raytrace_jax: (.*)$", page, re.MULTILINE)).split()
    public = {name for name in dir(raytrace_jax) if not name.startswith("_")}
    assert sorted(shown) == sorted(public - {"build", "glass", "optics"}) and "raytrace_jax.build" in page
    optics = " ".join(re.findall(r"^::: raytrace_jax\.optics: (.*)$", page, re.MULTILINE)).split()
    functions = {name for name, value in vars(raytrace_jax.optics).items() if not isinstance(value, ModuleType)}
    assert sorted(optics) == sorted(name for name in functions if not name.startswith("_"))


def test_blocks_are_found_with_their_output():
    page = "```python\n1\n```\n\n```text\nout\n```\n\n```sh\na\n```\n\nWords.\n\n```\n$ b\nc\n```\n"
    found = [(part.language, part.code, part.shown) for part in blocks.blocks(page)]
    assert found == [("python", "1\n", "out\n"), ("sh", "a\n", None), ("sh", "b\n", "c\n")]


@pytest.mark.parametrize(
    ("printed", "agrees"),
    [
        ("ball.ior 1.5 1.519958(67)\nconverged: at rest, -0.00007(31)", True),
        ("ball.ior 1.5 1.519958(67) converged: at\nrest, -0.00007(31)\n", True),
        ("ball.ior 1.5 1.519950(73)\nconverged: at rest, -0.00007(31)", True),
        ("ball.ior 1.5 1.519940(67)\nconverged: at rest, -0.00007(31)", False),
        ("ball.ior 1.5 1.519958(84)\nconverged: at rest, -0.00007(31)", False),
        ("ball.ior 1.5 1.519958(67)\nconverged: at rest, 0.00007(31)", False),
        ("ball.ior 1.5 1.519958(67)\nambiguous: at rest, -0.00007(31)", False),
        ("ball.ior 1.5 1.519958(67)\nconverged: at rest", False),
    ],
)
def test_pages_differ_by_more_than_rounding(printed, agrees):
    shown = "ball.ior       1.5      1.519958(67)\nconverged: at rest,\n-0.00007(31)\n"
    assert blocks.same(shown, printed) is agrees


@pytest.mark.parametrize(
    ("shown", "printed", "agrees"),
    [
        ("(3, 48, 64)", "(3, 47, 64)", False),
        ("camera=64x48", "camera=64x49", False),
        ("6.666580741335083e-05", "6.666580999999999e-05", True),
        ("6.666580741335083e-05", "6.6667e-05", False),
        ("[204.", "[205.", True),
    ],
)
def test_words_agree_by_their_numbers(shown, printed, agrees):
    assert blocks.same(shown, printed) is agrees


def test_blocks_run_and_say_what_fails(tmp_path):
    page = "```python\nx = 1\n```\n```sh\npip install x && echo a \\\n  b # c\n```\n```python\nprint(x)\n```\n"
    page += "```sh\nls no.jpg\nfalse\n```\n```python\nprint(y)\n```\n"
    first, second, third, fourth, last = blocks.run_blocks("page.md", blocks.blocks(page), tmp_path)
    assert (first.error, second.printed, second.skipped) == ("", "a b\n", ("pip install x",))
    assert third == blocks.Ran("1\n") and fourth.skipped == ("ls no.jpg",) and "exit code 1" in fourth.error
    assert "name 'y' is not defined" in last.error


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in blocks.PAGES if name != "gallery.md"])  # has tests of its own
def test_a_page_shows_what_its_blocks_print(name, capsys):
    assert blocks.check(name, write=False), capsys.readouterr().out
