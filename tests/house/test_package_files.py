"""What a maintainer finds beside the code: citation, classifiers, addresses, guide, forms and CI say the same."""

import re
import shutil
import tomllib
from fnmatch import fnmatch

import pytest
import yaml
from test_imports import ROOT

from raytrace_jax import __version__, load_scene
from raytrace_jax.scene.bundled import bundled_scenes, scene_folder

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_citation_has_version_and_title():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0" and citation["version"] == __version__
    assert f"# {citation['title'].partition(':')[0]}\n" == README[: README.index("\n") + 1]
    words = " ".join(README.split())
    assert f'as title "{citation["title"]}"' in words
    assert citation["authors"] == PROJECT["project"]["authors"]
    assert citation["authors"] == [{"name": name} for name in re.findall(r'name as authors "([^"]*)"', words)]
    assert citation["license"] == PROJECT["project"]["license"]
    assert citation["keywords"] == PROJECT["project"]["keywords"]


def test_package_index_links_are_absolute():
    text = README
    for rule in PROJECT["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    assert not [target for target in re.findall(r"\]\(([^)]*)\)", text) if not target.startswith("https://")]
    source = PROJECT["project"]["urls"]["Source"]
    pairs = re.findall(re.escape(source) + r"/(raw|blob)/v\$HFPR_VERSION/([^)#]*)", text)
    assert {kind for kind, _ in pairs} == {"raw", "blob"} and all((ROOT / path).is_file() for _, path in pairs)
    assert {path for kind, path in pairs if kind == "raw"} == {path for _, path in pairs if "/images/" in path}


def test_the_wheel_has_all_that_scenes_read(tmp_path):
    """Loaded from a folder with what goes into the wheel, as .ci/installed loads them from the wheel itself."""
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["only-include"] == ["raytrace_jax", "data"] and wheel["sources"] == {"data": "raytrace_jax/data"}
    kept_out = [
        path
        for path in (ROOT / "data").iterdir()
        if any(fnmatch(f"/data/{path.name}", rule) for rule in wheel["exclude"])
    ]
    shutil.copytree(scene_folder(), tmp_path / "data", ignore=lambda *_: [path.name for path in kept_out])
    for path in bundled_scenes().values():
        load_scene(tmp_path / "data" / path.name)
    assert {path.suffix for path in kept_out} <= {".exr", ".md"} and len(kept_out) == 3


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md"])
def test_files_named_for_contributors_exist(name):
    page = (ROOT / name).read_text(encoding="utf-8")
    words = [word for text in re.findall(r"`([^`\n]+)`", page) for word in text.split()]
    named = [
        word for word in words if re.fullmatch(r"[\w./-]+", word) and re.search(r"/|\.(py|md|toml|yaml|cff)$", word)
    ]
    named = [word for word in named if not word.startswith((".venv/", "output/"))] + re.findall(r"\]\(([^)]*)\)", page)
    folders = [ROOT, ROOT / "raytrace_jax" / "tracer" / "geometry"]
    assert not [word for word in named if not any((folder / word).exists() for folder in folders)]
    assert len(named) > 20 or name != "CONTRIBUTING.md"


def test_ci_runs_the_tested_versions():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    assert set(workflow[True]) == {"push", "pull_request"}  # YAML 1.1 reads the word `on` as true
    (job,) = workflow["jobs"].values()
    assert f"{' and '.join(job['strategy']['matrix']['python'])} are tested" in README
    assert {"run": ".ci/run"} in job["steps"]
