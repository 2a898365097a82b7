"""The package's layers: a module imports only from layers below its own, and private helpers sit below their users."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = "raytrace_jax"

LAYERS = [
    "_version _types _numerics _compile errors _words _numbers _files _schema",
    "scene settings",
    "optics rays film",
    "geometry coverage parameters modelfile exr png quantization pictures",
    "intersection",
    "edges",
    "nearest",
    "shading footprints visibility",
    "compaction",
    "wavefront",
    "plan",
    "render",
    "inverse derivatives ray_tree",
    "report journal gallery picture_files teaching _session",
    "batch",
    "cli",
    "__main__",
]
"""From the lowest layer to the highest; a folder is one entry. A private helper that is not listed belongs to the
lowest layer that uses it. Within a layer any import goes that makes no cycle."""


def module_name(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_name(path): path for path in sorted((ROOT / PACKAGE).rglob("*.py"))}


def imports(name, path):
    """The modules of the package that a module imports, wherever in its text it does so."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            wanted = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - (node.level - 1)] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            # `from package import name`: the name is a module, or something in the package itself.
            wanted = [f"{source}.{alias.name}" for alias in node.names]
            wanted = [name if name in MODULES else source for name in wanted]
        else:
            continue
        yield from (name for name in wanted if name in MODULES)


GRAPH = {name: sorted(set(imports(name, path)) - {name}) for name, path in MODULES.items()}


def entry(name):
    """The first name below the package: a module of it, or a folder; None for the package's front itself."""
    return name.split(".")[1] if "." in name else None


def level(name):
    """How high a module's layer is."""
    for height, layer in enumerate(LAYERS):
        if entry(name) in layer.split():
            return height
    users = [user for user, imported in GRAPH.items() if name in imported]
    assert entry(name).startswith("_") and users, f"{name} is in no layer: add it to LAYERS"
    return min(level(user) for user in users)


@pytest.mark.parametrize("name", [name for name in MODULES if entry(name)])
def test_imports_point_down(name):
    for imported in GRAPH[name]:
        assert entry(imported), f"{name} imports the package's front, which imports everything"
        assert level(imported) <= level(name), f"{name} imports {imported}, which lies above it"


def test_imports_have_no_cycle():
    finished = set()

    def visit(name, path):
        assert name not in path, "cycle: " + " -> ".join([*path[path.index(name) :], name])
        if name not in finished:
            for imported in GRAPH[name]:
                visit(imported, [*path, name])
            finished.add(name)

    for name in GRAPH:
        visit(name, [])


def test_the_walk_sees_the_imports():
    assert {"raytrace_jax.plan", "raytrace_jax.wavefront", "raytrace_jax.scene"} <= set(GRAPH["raytrace_jax.render"])
    assert "raytrace_jax.intersection" in GRAPH["raytrace_jax.shading.classic"]
    assert len(GRAPH) > 20
