"""The house and its page: packages import only from those below them, without cycles; what the page names exists."""

import ast
import inspect
import re
from itertools import pairwise
from pathlib import Path

import pytest

import raytrace_jax

ROOT = Path(__file__).parents[2]
PACKAGE = "raytrace_jax"

FLOORS = ["cli", "batch", "report", "photo", "inverse exchange", "tracer", "scene", "images optics", "util"]
"""The packages, from the highest floor to the lowest; those on one floor do not know each other."""

INNER_FLOORS = {
    "tracer": ["shading visibility", "geometry"],
    "inverse": ["solve", "judge", "problem"],
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


def absolute(path, node):
    """The module that an import is from: dots count packages, the first one the file's own."""
    if not node.level:
        return node.module
    package = path.relative_to(ROOT).parts[: -node.level]
    return ".".join([*package, *filter(None, [node.module])])


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
            assert node.level or PACKAGE not in node.module, f"{path}: imports within the package are relative"
            module = absolute(path, node)
            # `from package import name`: the name is a module, or something in the package itself.
            wanted = [f"{module}.{alias.name}" for alias in node.names]
            wanted = [name if name in MODULES else module for name in wanted]
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
    package = name if MODULES[name].name == "__init__.py" else name.rpartition(".")[0]
    return (package.split(".") + [""] * depth)[depth]


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


def test_no_module_is_named_as_a_function():
    public = {*raytrace_jax.__all__} - {"__version__", "optics", "build", "glass"}
    # The commands of the command line are called as users type them.
    modules = {name.rpartition(".")[2] for name in MODULES if not name.startswith(f"{PACKAGE}.cli.")}
    assert not public & modules


def test_the_front_shows_what_is_public():
    seen = {name for name in dir(raytrace_jax) if not name.startswith("__")}
    assert seen == {name for name in raytrace_jax.__all__ if name != "__version__"}
    assert {"Film", "PictureResidual"} <= seen and "__version__" in dir(raytrace_jax)


def test_public_functions_say_their_returns():
    functions = {name: getattr(raytrace_jax, name) for name in raytrace_jax.__all__}
    for name, function in functions.items():
        if inspect.isfunction(function) and inspect.signature(function).return_annotation is not None:
            summary = inspect.getdoc(function) or ""
            assert "\nReturns:\n" in summary or summary.startswith(("The ", "Return ")), name


def test_public_members_have_words():
    for name in raytrace_jax.__all__:
        found = getattr(raytrace_jax, name)
        if inspect.isclass(found) and not issubclass(found, Exception):
            members = {key: one for key, one in vars(found).items() if not key.startswith("_")}
            own = [key for key, one in members.items() if inspect.isroutine(one) or isinstance(one, property)]
            assert all(inspect.getdoc(members[key]) for key in own), (name, own)


PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PICTURE = PAGE.partition("```mermaid")[2].partition("```")[0]


def test_the_page_names_what_exists():
    named = [name for name in re.findall(r"`([^`\s]+)`", PAGE) if "/" in name or re.search(r"\.\w+$", name)]
    named = [name for name in named if name not in ("model.txt",)]
    missing = [name for name in named if not any((folder / name).exists() for folder in (ROOT, ROOT / "raytrace_jax"))]
    assert len(named) > 50 and not missing
    packages = [path.parent for path in (ROOT / PACKAGE).rglob("__init__.py")][1:]
    assert not [name for path in packages if (name := path.relative_to(ROOT / PACKAGE).as_posix()) not in PAGE]


def test_the_diagram_has_rooms_and_arrows():
    rooms = set(re.findall(r"^ +(\w+)\[", PICTURE, re.MULTILINE))
    assert rooms == {room for rooms in FLOORS for room in rooms.split()}
    arrows = {arrow for line in PICTURE.splitlines() if "-->" in line for arrow in pairwise(re.findall(r"\w+", line))}
    assert arrows == {
        (upper, lower) for above, below in pairwise(FLOORS) for upper in above.split() for lower in below.split()
    }
