"""Progress on stderr: on a terminal something that changes, else a line now and then."""

import threading
import time
from typing import Any, Self

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ..inverse.result import FitStep
from ..util.compilation import is_compiling

SECONDS_BETWEEN = 5.0  # Where there is no terminal, the least time between two lines on one kind of work.
SILENCE = 8.0  # There, the time without any line after which one says that work goes on.


class Shown:
    """A display from entering the context to leaving it, if on a terminal; else lines, one every few seconds.

    A quiet console shows nothing. Lines that only say that work goes on have the `words` for it; without words there
    are none.
    """

    def __init__(self, console: Console, display: Any, words: str):
        self.console, self.words = console, words
        self.display = display if console.is_terminal and not console.quiet else None
        self.began = self.said = self.entered = time.monotonic()
        self.over = threading.Event()

    def __enter__(self) -> Self:
        if self.display:
            self.display.start()
        elif self.words and not self.console.quiet:
            threading.Thread(target=self._go_on, name="progress", daemon=True).start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.over.set()
        if self.display:
            self.display.stop()

    def say(self, line: str) -> None:
        self.said = time.monotonic()
        self.console.print(line, highlight=False)

    def _go_on(self) -> None:
        while not self.over.wait(1.0):
            now = time.monotonic()
            if now - self.said >= SILENCE:
                self.say(f"{now - self.entered:.1f} s  {self.words}{': compiling' if is_compiling() else ''}")


class Timer(Shown):
    """Says how long each part of some work took, and on a terminal that it is under way: use it as a context."""

    def __init__(self, words: str, console: Console):
        super().__init__(console, console.status(f"{words} ..."), words)

    def took(self, what: str) -> None:
        """Say how long it is since the last part ended, or since the beginning."""
        now = time.monotonic()
        self.say(f"{what} took {now - self.began:.1f} s")
        self.began = now


class FitProgress(Shown):
    """Shows the phases and steps of a fit, with its free scalar parameters: use it as a context."""

    def __init__(self, names: tuple[str, ...], console: Console):
        super().__init__(console, Live(console=console), "starting")
        self.names, self.shown_at, self.stepped_at = names, 0.0, self.began
        self.last: FitStep | None = None
        if self.display:
            self.display.update(self._table())

    def phase(self, words: str) -> None:
        now = time.monotonic()
        is_new = words.split(",")[0] != self.words.split(",")[0]
        self.words = words
        if self.display:
            self.display.update(self._table(), refresh=True)
        elif is_new or now - self.shown_at > SECONDS_BETWEEN:
            self.shown_at = now
            self.say(f"{now - self.began:.1f} s  {words}")

    def step(self, step: FitStep) -> None:
        self.last, self.stepped_at = step, time.monotonic()
        if self.display:
            self.display.update(self._table())
        else:
            pieces = (f"{what} {text}" for what, text in self._where(step))
            self.say("  ".join([f"{self.stepped_at - self.began:.1f} s", *pieces]))

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        table.add_row(Text(f"{time.monotonic() - self.began:.1f} s", style="dim"), self.words)
        if self.last is not None:
            for what, text in self._where(self.last):
                table.add_row(Text(what, style="dim"), text)
        return table

    def _where(self, step: FitStep) -> list[tuple[str, str]]:
        number = f"{step.step}{'' if step.accepted else ' (rejected)'}"
        found = {"start": f"{step.candidate + 1}", "blur": f"{step.blur:g} px", "step": number}
        found["cost"] = f"{step.cost:.6g}"
        values = [(name, f"{value:.7g}") for name, value in zip(self.names, step.value, strict=True)]
        return [*found.items(), *values]
