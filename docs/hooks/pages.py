"""Pages and links of the site, which MkDocs asks for while it builds.

Name, description and address come from `pyproject.toml`. Some pages are made at build time, so that nothing is written
twice: `commands.md` from the command line's own help, `index.md` from `README.md`, `contributing.md` and `changelog.md`
from the files of these names at the root, `notebooks/*.md` from the teaching notebooks. Links that leave `docs/` become
those of the repository's address.
"""

import base64
import functools
import html
import inspect
import json
import os
import posixpath
import re
import subprocess
import sys
import textwrap
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = 100
ROOT_PAGES = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}
"""Pages of the site that are files at the root of the repository."""

TEACHING = "experiments/teaching"
NOTEBOOKS = {f"notebooks/{path.stem}.md": f"{TEACHING}/{path.name}" for path in (ROOT / TEACHING).glob("*.ipynb")}
"""Pages of the site that are notebooks."""

LINK = re.compile(r"(?P<before>(?P<picture>!?)\[(?:[^\[\]]|\[[^\]]*\])*\]\()(?P<target>[^)\s]+)(?P<after>\))")
CONSTRUCTORS = "<!-- constructors of blocks -->"
"""Where the page on Python has the functions of `raytrace_jax.build`, which no source text shows."""

NAMES = re.compile(r"^::: (?P<module>[\w.]+): (?P<names>.+)$", re.MULTILINE)
"""Names of a module, each of which has its docstring there."""

CODE = re.compile(r"(^ *```.*?^ *```$|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
ANSI = re.compile(r"\x1b\[[0-9;]*m")


@functools.cache
def project() -> dict:
    """The table `project` of `pyproject.toml`."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Fill in what `pyproject.toml` says."""
    config.site_name = project()["name"]
    config.site_description = project()["description"]
    config.repo_url = project()["urls"]["Source"]
    config.repo_name = "Source"
    config.copyright = f"{project()['authors'][0]['name']}, {project()['license']} licence"
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made here."""
    pages = {name: (ROOT / source).read_text(encoding="utf-8") for name, source in ROOT_PAGES.items()}
    for name, text in {**pages, "commands.md": commands_page()}.items():
        files.append(File.generated(config, name, content=text))
    for name, source in NOTEBOOKS.items():
        text, pictures = notebook_page(name, source)
        for place, content in {name: text, **pictures}.items():
            files.append(File.generated(config, place, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links to files of the repository that are no pages into links to the repository."""
    name = page.file.src_uri
    place = {**ROOT_PAGES, **NOTEBOOKS}.get(name, f"docs/{name}")
    if CONSTRUCTORS in markdown:
        markdown = markdown.replace(CONSTRUCTORS, constructors())
    markdown = NAMES.sub(_docstrings, markdown)
    parts = CODE.split(markdown)
    parts[::2] = [LINK.sub(functools.partial(_moved, place, name), part) for part in parts[::2]]
    return "".join(parts)


def _docstrings(line: re.Match) -> str:
    """A line for each name, as mkdocstrings takes them."""
    return "\n\n".join(f"::: {line['module']}.{name}" for name in line["names"].split())


def _moved(place: str, name: str, link: re.Match) -> str:
    """The link as the site has it: `place` is where its page lies in the repository, `name` where in the site."""
    target, mark, anchor = link["target"].partition("#")
    if not target or re.match(r"[a-z][a-z+.-]*:", target):
        return link[0]
    path = posixpath.normpath(posixpath.join(posixpath.dirname(place), target))
    site_name = {source: page for page, source in {**ROOT_PAGES, **NOTEBOOKS}.items()}.get(path)
    if path.startswith("docs/"):
        site_name = path.removeprefix("docs/")
    if site_name:
        moved = posixpath.relpath(site_name, posixpath.dirname(name) or ".")
    elif (ROOT / path).exists():
        kind = "raw" if link["picture"] else "tree" if (ROOT / path).is_dir() else "blob"
        moved = f"{project()['urls']['Source']}/{kind}/HEAD/{path}"
    else:
        return link[0]  # A mistake: MkDocs tells it.
    return f"{link['before']}{moved}{mark}{anchor}{link['after']}"


def notebook_page(name: str, source: str) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and its pictures by the names that they have in the site."""
    cells = json.loads((ROOT / source).read_text(encoding="utf-8"))["cells"]
    stem, pictures = name.removesuffix(".md"), {}
    parts = []
    for number, cell in enumerate(cells):
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            for attached, data in cell.get("attachments", {}).items():
                place = f"{stem}-{attached}"
                text = text.replace(f"attachment:{attached}", posixpath.basename(place))
                pictures[place] = base64.b64decode(data["image/png"])
            parts.append(text)
        elif "%pip install" not in text:  # the page's reader runs nothing
            parts.append(f"```python\n{text}\n```")
            for at, output in enumerate(cell["outputs"]):
                parts.append(_output(output, place := f"{stem}-{number}-{at}.png"))
                if picture := output.get("data", {}).get("image/png"):
                    pictures[place] = base64.b64decode(picture)
    address = f"{project()['urls']['Source']}/blob/HEAD/{source}"
    parts.append(f"[This notebook]({address}) can be run from a checkout of the repository.")
    return "\n\n".join(parts) + "\n", pictures


def _output(output: dict, place: str) -> str:
    """What a cell printed, drew or ended with, as Markdown; `place` is where the site has its picture."""
    data = output.get("data", {})
    if "image/png" in data:
        return f"![What this code draws]({posixpath.basename(place)})"
    if "text/html" in data:
        return f'<div markdown="0">{"".join(data["text/html"])}</div>'
    return f"```text\n{''.join(output.get('text') or data['text/plain']).rstrip()}\n```"


def constructors() -> str:
    """A heading for each function that describes a block, and its docstring."""
    from raytrace_jax import build

    names = [name for name in dir(build) if name != "make_scene"]
    parts = (f"#### build.{name} {{ #build-{name} }}\n\n{_constructor(getattr(build, name).__doc__)}" for name in names)
    return "\n\n".join(parts)


def _constructor(text: str) -> str:
    """The docstring of such a function, its attributes as a block of code."""
    first, _, attributes = text.partition("\n\n")
    return f"{first}\n\n```text\n{inspect.cleandoc(attributes)}\n```"


@functools.cache
def commands_page() -> str:
    """The page of all commands: for each its purpose and what it prints with `--help`."""
    from raytrace_jax.cli.dispatch import COMMANDS

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        whole, *helps = threads.map(help_text, ["", *COMMANDS])
    parts = [
        "---\nhide: [navigation]  # help texts are wide\n---",
        "# Command line",
        "The program prints these texts with `--help`. They are taken from it when the site is built. "
        "[The command line](command_line.md) says what all commands have in common.",
        "| command | purpose |\n|---|---|",
    ]
    purposes = [html.escape(entry.options.__doc__.splitlines()[0], quote=False) for entry in COMMANDS.values()]
    rows = (f"| [`{name}`](#{name}) | {text} |" for name, text in zip(COMMANDS, purposes, strict=True))
    parts[-1] += "\n" + "\n".join(rows)
    parts.append(f"## raytrace-jax {{ #raytrace-jax }}\n\n```text\n{whole}\n```")
    for name, purpose, text in zip(COMMANDS, purposes, helps, strict=True):
        parts.append(f"## {name} {{ #{name} }}\n\n{purpose}\n\n```text\n{text}\n```")
    return "\n\n".join(parts) + "\n"


def help_text(command: str) -> str:
    """What the program prints for `COMMAND --help`, without colours, on lines of so many columns at most."""
    env = {**os.environ, "COLUMNS": str(COLUMNS), "NO_COLOR": "1", "TERM": "dumb", "PYTHONIOENCODING": "utf-8"}
    env.pop("FORCE_COLOR", None)
    arguments = [sys.executable, "-m", "raytrace_jax", *([command] if command else []), "--help"]
    done = subprocess.run(arguments, capture_output=True, encoding="utf-8", env=env, cwd=ROOT, check=True)
    lines = ANSI.sub("", done.stdout).strip().splitlines()
    return "\n".join(part for line in lines for part in textwrap.wrap(line, COLUMNS) or [""])
