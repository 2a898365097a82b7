"""The pages of the site: what MkDocs needs is there, links lead somewhere, and the code of pages runs."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from command_line import run

from raytrace_jax import FitResult

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
NOTEBOOKS = {f"notebooks/{path.stem}.md" for path in (ROOT / "experiments" / "teaching").glob("*.ipynb")}
MADE = {"index.md", "commands.md", "contributing.md", "changelog.md"} | NOTEBOOKS
"""Pages that `docs/hooks/pages.py` makes when the site is built."""

LINK = re.compile(r"\]\(([^)\s]+)\)")
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


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
    assert sorted(shown) == sorted(public - {"build", "optics"}) and "raytrace_jax.build" in page
    optics = " ".join(re.findall(r"^::: raytrace_jax\.optics: (.*)$", page, re.MULTILINE)).split()
    functions = {name for name, value in vars(raytrace_jax.optics).items() if not isinstance(value, ModuleType)}
    assert sorted(optics) == sorted(name for name in functions if not name.startswith("_"))


@pytest.mark.slow
@pytest.mark.optimized
def test_the_commands_of_the_photo_page_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (DOCS / "own_picture.md").read_text(encoding="utf-8").replace("\\\n", " ")
    for block in re.findall(r"^```sh\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
        for line in block.splitlines():
            assert run(*shlex.split(line, comments=True)[1:]) == 0, line
    estimate = FitResult.load("result")["ball.ior"]
    assert abs(estimate.value - 1.47) < 3 * estimate.error
    assert "converged" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tutorial.md", "recipes.md"])
def test_the_code_of_a_page_runs(name, tmp_path):
    """All blocks of Python as one program."""
    program = "\n".join(BLOCK.findall((DOCS / name).read_text(encoding="utf-8")))
    environment = os.environ | {"PYTHONPATH": str(ROOT), "JAX_ENABLE_X64": "0"}
    options = {"cwd": tmp_path, "env": environment, "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, "-"], input=program, check=False, **options)
    assert done.returncode == 0 and done.stdout, done.stderr
