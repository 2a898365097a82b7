"""How heavy is the house? Counts files, classes, lines, named numbers, comments and what tests reach into.

    .venv/bin/python experiments/suite/counts.py [TREE]

Prints one Markdown table of a checkout, this one by default. Lines are all lines of a file; code lines are those that
hold more than a comment, a docstring or nothing.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = "raytrace_jax"
LONG = 40
"""Lines of a function from which on it is to name its phases."""

UNCLEAR = re.compile(r"(Of|Those|Nor|The same|By) ")
"""How no docstring is to begin."""


def sources(folder: Path) -> list[Path]:
    """The Python files of a folder and those below it."""
    return sorted(folder.rglob("*.py"))


def lines(folder: Path) -> int:
    """All lines of a folder's Python files."""
    return sum(len(path.read_text().splitlines()) for path in sources(folder))


def classes(folder: Path) -> int:
    """The classes of a folder, also those within functions and classes."""
    return sum(isinstance(node, ast.ClassDef) for path in sources(folder) for node in ast.walk(parsed(path)))


def parsed(path: Path) -> ast.Module:
    """A file's syntax tree."""
    return ast.parse(path.read_text())


def comments_and_code(folder: Path) -> tuple[int, int]:
    """Lines with a comment, and lines with code."""
    commented, coded = 0, 0
    quiet = (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING, tokenize.ENDMARKER)
    for path in sources(folder):
        text, code, comment = path.read_text(), set[int](), set[int]()
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            rows = range(token.start[0], token.end[0] + 1)
            if token.type == tokenize.COMMENT:
                comment.update(rows)
            elif token.type not in quiet:
                code.update(rows)
        code -= {row for node in docstrings(ast.parse(text)) for row in range(node.lineno, (node.end_lineno or 0) + 1)}
        commented, coded = commented + len(comment), coded + len(code)
    return commented, coded


def docstrings(tree: ast.Module) -> Iterator[ast.Constant]:
    """The docstrings of a file: its own, of its functions and classes, and those that follow a name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value


def is_number(node: ast.expr | None) -> bool:
    """Whether an expression is made of numbers only."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.Tuple | ast.List):
        return bool(node.elts) and all(map(is_number, node.elts))
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    return isinstance(node, ast.BinOp) and is_number(node.left) and is_number(node.right)


def named_numbers(folder: Path) -> int:
    """Names in capitals that modules give to numbers; a tuple of names counts as many."""
    count = 0
    for path in sources(folder):
        for node in parsed(path).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and is_number(node.value):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
                count += sum(name.isupper() for name in names)
    return count


def unclear_docstrings(folder: Path) -> int:
    """Docstrings that begin with a word that leans on something else."""
    found = (node.value for path in sources(folder) for node in docstrings(parsed(path)))
    return sum(bool(UNCLEAR.match(text.strip())) for text in found if isinstance(text, str))


def long_functions(folder: Path) -> int:
    """Functions of more than `LONG` lines."""
    nodes = (node for path in sources(folder) for node in ast.walk(parsed(path)))
    return sum(isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.lineno + 1 > LONG for node in nodes)


def test_imports(folder: Path) -> tuple[int, int]:
    """Import lines of tests that reach inside the package, and those that use what is public."""
    text = "\n".join(path.read_text() for path in sources(folder))
    inside = len(re.findall(rf"^\s*(?:from {PACKAGE}\.|import {PACKAGE}\.)", text, re.MULTILINE))
    return inside, len(re.findall(rf"^\s*(?:from {PACKAGE} import|import {PACKAGE}\b(?!\.))", text, re.MULTILINE))


def replaced_names(folder: Path) -> int:
    """How often tests replace something by its dotted path."""
    pattern = rf"setattr\(\s*f?\"{PACKAGE}\."
    return sum(len(re.findall(pattern, path.read_text())) for path in sources(folder))


def main(tree: Path) -> None:
    """Print the table."""
    package, tests = tree / PACKAGE, tree / "tests"
    inverse, visibility = package / "inverse", package / "tracer" / "visibility"
    shares = [commented / coded for commented, coded in map(comments_and_code, (inverse, visibility))]
    inside, public = test_imports(tests)
    rows = {
        "`inverse`: files / classes / lines": f"{len(sources(inverse))} / {classes(inverse)} / {lines(inverse)}",
        "package, lines": lines(package),
        "numbers with a module's name": named_numbers(package),
        "comments in `inverse` / `tracer/visibility`": " / ".join(f"{share:.1%}" for share in shares),
        "docstrings that begin unclearly": unclear_docstrings(package),
        f"functions of more than {LONG} lines": long_functions(package),
        "tests: dotted replacements": replaced_names(tests),
        "tests: imports inside / public": f"{inside} / {public}",
    }
    print("| | |\n|---|---|")
    for what, count in rows.items():
        print(f"| {what} | {count} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
