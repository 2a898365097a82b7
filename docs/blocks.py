"""Run the blocks of pages, and compare what they print with what the pages say.

    python docs/blocks.py [PAGE ...] [--write]      # as tutorial.md or README.md; all pages take half an hour

The Python of a page is one program, and its commands run one after the other, all in one folder: an empty one, or for
README and the gallery one with what a checkout has. A block ```text is what the block before it prints. A block without
a language whose first line begins with `$` is a command and its output. `--write` puts what is printed into the pages.
"""

import difflib
import re
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pictures

PAGES = (
    "README.md",
    "tutorial.md",
    "own_picture.md",
    "photograph.md",
    "scenes.md",
    "api.md",
    "gallery.md",
    "recipes.md",
)
CHECKOUTS = ("README.md", "gallery.md")
"""Pages whose blocks run in a checkout."""

BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```$(?:\n+```text\n(.*?)^```$)?", re.MULTILINE | re.DOTALL)
CONSOLE = re.compile(r"^```()\n\$ (.*?\n)(.*?)^```$", re.MULTILINE | re.DOTALL)
INSTALL = re.compile(r"\bvenv \.venv|\bpip install\b|-m pytest\b")
PHOTOGRAPH = re.compile(r"\S+\.jpg\b")
NUMBER = re.compile(r"(?<![\w.)])[-+]?\d+\.?\d*(?:e[-+]?\d+)?|\d+\.?\d*")
ESTIMATE = re.compile(r"(-?\d+\.?\d*)\((\d+\.?\d*)\)")
END = "\x1e"
"""A line of it ends the output of a block of Python."""


class Block(NamedTuple):
    """A block of a page: its code, what the page says that it prints, and where in the page that stands."""

    language: str
    code: str
    shown: str | None
    place: tuple[int, int]


class Ran(NamedTuple):
    """What a block printed, why it failed (or nothing), and the commands that were left out."""

    printed: str = ""
    error: str = ""
    skipped: tuple[str, ...] = ()


def path_of(page: str) -> Path:
    """The file of a page."""
    return (pictures.ROOT if page == "README.md" else pictures.DOCS) / page


def blocks(text: str) -> list[Block]:
    """The blocks of a page that can be run, in their order."""
    found = sorted([*BLOCK.finditer(text), *CONSOLE.finditer(text)], key=lambda match: match.start())
    return [Block(match[1] or "sh", match[2], match[3], match.span(3)) for match in found]


def run_blocks(page: str, parts: list[Block], folder: Path) -> Iterator[Ran]:
    """Run blocks of a page in an empty folder, and tell of each what became of it."""
    if page in CHECKOUTS:
        pictures.prepare(folder)
    session = run_python([part.code for part in parts if part.language == "python"], folder)
    for part in parts:
        yield next(session) if part.language == "python" else run_commands(part.code, folder)


def run_python(codes: list[str], folder: Path) -> Iterator[Ran]:
    """Run blocks of Python as one program, each when it is asked for the next."""
    program = "".join(f"{code}\nprint({END!r}, flush=True)\n" for code in codes)
    settings = {"cwd": folder, "env": pictures.environment(), "text": True, "stdout": subprocess.PIPE}
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8") as errors,
        subprocess.Popen([sys.executable, "-c", program], stderr=errors, **settings) as session,
    ):
        for _ in codes:
            lines = []
            for line in session.stdout or ():
                if line == f"{END}\n":
                    yield Ran("".join(lines))
                    break
                lines.append(line)
            else:
                errors.seek(0)
                yield Ran("".join(lines), errors.read() or "the program had ended")


def run_commands(text: str, folder: Path) -> Ran:
    """Run commands, except those that install something or want a photograph that is not there."""
    printed, skipped = "", []
    for line in text.replace("\\\n", " ").splitlines():
        for command in line.partition(" #")[0].replace(".venv/bin/", "").split(" && "):
            photographs = [name for name in PHOTOGRAPH.findall(command) if not any(folder.glob(name))]
            if not command.strip() or INSTALL.search(command) or photographs:
                skipped += [command] if command.strip() else []
                continue
            settings = {"cwd": folder, "env": pictures.environment(), "capture_output": True, "text": True}
            done = subprocess.run(["bash", "-c", command], check=False, **settings)
            printed += done.stdout
            if done.returncode:
                return Ran(printed, f"{command}\nexit code {done.returncode}\n{done.stderr}", tuple(skipped))
    return Ran(printed, "", tuple(skipped))


def same(shown: str, printed: str) -> bool:
    """Whether a page shows what was printed, but for where lines break and what differs from machine to machine.

    An estimate as 1.5200(13) and its error may differ by a fifth of the error: where a solver comes to rest depends on
    rounding. Other numbers with decimals agree within two of their last digit or a millionth, whole ones are the same.
    """
    ours, theirs = shown.split(), printed.split()
    return len(ours) == len(theirs) and all(map(same_word, ours, theirs))


def same_word(shown: str, printed: str) -> bool:
    """Whether two words are the same but for rounding."""
    pattern = ESTIMATE if ESTIMATE.search(shown) else NUMBER
    if pattern.sub("", shown) != pattern.sub("", printed):
        return False
    pairs = zip(pattern.finditer(shown), pattern.finditer(printed), strict=True)
    return all(abs(x - y) <= d for a, b in pairs for x, y, d in zip(numbers(a), numbers(b), leeways(a), strict=True))


def numbers(match: re.Match[str]) -> list[float]:
    """The number that was found, or an estimate and its error."""
    if match.re is NUMBER:
        return [float(match[0])]
    return [float(match[1]), float(match[2]) * (1.0 if "." in match[2] else last_digit(match[1]))]


def leeways(match: re.Match[str]) -> list[float]:
    """By how much each of these numbers may differ."""
    if match.re is NUMBER:
        exact = match[0].lstrip("+-").isdigit()
        return [0.0 if exact else max(1e-6 * abs(float(match[0])), 2.001 * last_digit(match[0]))]
    return 2 * [numbers(match)[1] / 5]


def last_digit(number: str) -> float:
    """What one in the last digit of a number is."""
    mantissa, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def check(page: str, write: bool) -> bool:
    """Run a page's blocks, say of each whether the page is right, and whether all of them are."""
    text = path_of(page).read_text(encoding="utf-8")
    parts, right, changes = blocks(text), True, []
    with tempfile.TemporaryDirectory() as folder:
        start = time.monotonic()
        for part, ran in zip(parts, run_blocks(page, parts, Path(folder)), strict=True):
            seconds, start = time.monotonic() - start, time.monotonic()
            agrees = part.shown is None or bool(ran.skipped) or same(part.shown, ran.printed)
            word = "fails" if ran.error else "ok" if agrees else "differs"
            print(f"{page}:{text.count(chr(10), 0, text.index(part.code)) + 1} {word}, {seconds:.0f} s", flush=True)
            print("".join(f"    left out: {command.strip()}\n" for command in ran.skipped), end="")
            right = right and agrees and not ran.error
            if ran.error:
                print(textwrap.indent(ran.error, "    "))
            elif not agrees:
                changes.append((part.place, wrapped(ran.printed)))
                words = difflib.ndiff((part.shown or "").split(), ran.printed.split())
                print("".join(f"    {word}\n" for word in words if word[0] in "-+"), end="", flush=True)
    if write:
        for (begin, end), printed in reversed(changes):
            text = text[:begin] + printed + text[end:]
        path_of(page).write_text(text, encoding="utf-8")
    return right


def wrapped(printed: str) -> str:
    """Output with no line longer than a page's."""
    lines = [textwrap.fill(line, 120) if len(line) > 120 else line.rstrip() for line in printed.splitlines()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    names = [argument for argument in sys.argv[1:] if argument != "--write"]
    answers = [check(page, "--write" in sys.argv) for page in names or PAGES]
    sys.exit(not all(answers))
