"""The house: packages import only from those below them, nothing else lies at its root, and there are no cycles."""

import ast
import inspect
from pathlib import Path

import pytest

import raytrace_jax

ROOT = Path(__file__).parent.parent
PACKAGE = "raytrace_jax"

FLOORS = ["cli", "batch", "report", "photo", "inverse exchange", "tracer", "scene", "images optics", "util"]
"""The packages, from the highest floor to the lowest; those on one floor do not know each other."""

INNER_FLOORS = {
    "tracer": ["levels", "shading visibility", "geometry"],
}
"""The same of packages within a package; the modules beside them may lie anywhere between."""

ROOT_FILES = {"__init__.py", "__main__.py", "_version.py", "errors.py", "py.typed"}


def module_name(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_name(path): path for path in sorted((ROOT / PACKAGE).rglob("*.py"))}


OFFERED = {f"{PACKAGE}.scene.scene": "Scene", f"{PACKAGE}.inverse.result": "FitResult"}
"""The classes on which users look for what modules above do, by their modules."""


def delegation(method):
    """The import of a method that is nothing but a documented call of the function that it imports, else None."""
    body = method.body[1:] if ast.get_docstring(method) else method.body
    match body:
        case [
            ast.ImportFrom(names=[ast.alias(name=imported, asname=None)]) as node,
            ast.Return(value=ast.Call(func=ast.Name(id=called))) | ast.Expr(value=ast.Call(func=ast.Name(id=called))),
        ] if called == imported:
            return node
    return None


def delegations(module, tree):
    """The imports of the methods that only offer what a module above does."""
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == OFFERED.get(module)]
    methods = [node for one in classes for node in one.body if isinstance(node, ast.FunctionDef)]
    return [node for node in map(delegation, methods) if node]


def imports(path):
    """The modules of the package that a module imports, wherever in its text it does so.

    Methods that only delegate are left out: nothing in the module itself needs what they offer.
    """
    tree = ast.parse(path.read_text(encoding="utf-8"))
    offered = delegations(module_name(path), tree)
    for node in ast.walk(tree):
        if node in offered:
            continue
        if isinstance(node, ast.Import):
            wanted = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute, one style for all"
            # `from package import name`: the name is a module, or something in the package itself.
            wanted = [f"{node.module}.{alias.name}" for alias in node.names]
            wanted = [name if name in MODULES else node.module for name in wanted]
        else:
            continue
        yield from (name for name in wanted if name in MODULES)
        # A module's packages are run before it, but for those that the importing module lies in itself.
        packages = (name.rsplit(".", k)[0] for name in wanted if name in MODULES for k in range(1, name.count(".")))
        yield from (package for package in packages if not module_name(path).startswith(f"{package}."))


GRAPH = {name: sorted(set(imports(path)) - {name}) for name, path in MODULES.items()}


def floor(floors, room):
    """How high a room lies, None for what is no room."""
    return next((height for height, rooms in enumerate(reversed(floors)) if room in rooms.split()), None)


def room(name, depth):
    """The part of a module's name at a depth, if that is a package."""
    parts = name.split(".")
    return (
        parts[depth] if len(parts) > depth + 1 or (len(parts) > depth and MODULES[name].name == "__init__.py") else ""
    )


def check_floors(floors, depth, name, imported):
    here, there = room(name, depth), room(imported, depth)
    if here == there or floor(floors, here) is None or floor(floors, there) is None:
        return
    assert floor(floors, there) < floor(floors, here), f"{name} imports {imported}, which does not lie below it"


@pytest.mark.parametrize("name", [name for name in MODULES if name not in (PACKAGE, f"{PACKAGE}.__main__")])
def test_imports_point_down(name):
    for imported in GRAPH[name]:
        assert imported != PACKAGE, f"{name} imports the package's front, which imports everything"
        check_floors(FLOORS, 1, name, imported)
        package = room(name, 1)
        if package == room(imported, 1) and package in INNER_FLOORS:
            check_floors(INNER_FLOORS[package], 2, name, imported)
        if name == f"{PACKAGE}.errors":
            assert imported == f"{PACKAGE}._version"


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


def test_only_rooms_lie_at_the_root():
    folder = ROOT / PACKAGE
    assert {path.name for path in folder.iterdir() if path.is_file()} == ROOT_FILES
    rooms = {path.name for path in folder.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert rooms == {room for rooms in FLOORS for room in rooms.split()}


def test_no_module_has_the_name_of_a_public_function():
    public = {name for name in raytrace_jax.__all__ if name not in ("__version__", *raytrace_jax._WHOLE)}
    # The commands of the command line are called as users type them.
    modules = {name.rpartition(".")[2] for name in MODULES if not name.startswith(f"{PACKAGE}.cli.")}
    assert not public & modules


def test_the_front_shows_what_is_public_and_nothing_else():
    seen = {name for name in dir(raytrace_jax) if not name.startswith("__")}
    assert seen == {name for name in raytrace_jax.__all__ if name != "__version__"}
    assert {"Renderer", "PictureDerivatives", "PictureResidual"} <= seen and "__version__" in dir(raytrace_jax)


def test_every_public_function_says_what_it_returns():
    functions = {name: getattr(raytrace_jax, name) for name in raytrace_jax.__all__}
    for name, function in functions.items():
        if inspect.isfunction(function) and inspect.signature(function).return_annotation is not None:
            summary = inspect.getdoc(function) or ""
            assert "\nReturns:\n" in summary or summary.startswith(("The ", "Return ")), name


def test_no_module_is_marked_as_private():
    """What is public is what the package's front lists; within the house all modules are alike."""
    names = {path.name for path in MODULES.values()} - {"__init__.py", "__main__.py", "_version.py"}
    assert not [name for name in names if name.startswith("_")]


def test_only_methods_that_delegate_are_left_out():
    found = {
        module: [node.module for node in delegations(module, ast.parse(MODULES[module].read_text()))]
        for module in MODULES
    }
    assert {module: len(nodes) for module, nodes in found.items() if nodes} == {
        f"{PACKAGE}.scene.scene": 4,
        f"{PACKAGE}.inverse.result": 4,
    }
    does_more = """
class Scene:
    def save(self, path):
        from raytrace_jax.scene.writer import save_scene

        return save_scene(self, path).strip()
"""
    assert not delegations(f"{PACKAGE}.scene.scene", ast.parse(does_more))
    assert not delegations(f"{PACKAGE}.scene.parameters", ast.parse(does_more.replace(".strip()", "")))
    assert delegations(f"{PACKAGE}.scene.scene", ast.parse(does_more.replace(".strip()", "")))


def test_the_walk_sees_the_imports():
    assert f"{PACKAGE}.scene.scene" in GRAPH[f"{PACKAGE}.tracer.rendering"]
    assert f"{PACKAGE}.tracer.geometry.intersection" in GRAPH[f"{PACKAGE}.tracer.shading.classic"]
    assert len(GRAPH) > 100
