"""Progress on stderr: on a terminal something that changes, else a line now and then."""

import threading
import time
from typing import Any, Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from ..inverse.result import FitStep
from ..util.compilation import is_compiling

SECONDS_BETWEEN = 5.0  # Where there is no terminal, the least time between two lines on one kind of work.
SILENCE = 8.0  # There, the time without any line after which one says that work goes on.


class Shown:
    """A display from entering the context to leaving it, on a terminal that can overwrite; else lines now and then.

    A quiet console shows nothing. Lines that only say that work goes on have the `words` for it; without words there
    are none.
    """

    def __init__(self, console: Console, display: Any, words: str):
        self.console, self.words = console, words
        overwrites = console.is_terminal and not console.is_dumb_terminal
        self.display = display if overwrites and not console.quiet else None
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
    """Shows the phases and steps of a fit, with its free scalar parameters: use it as a context.

    On a terminal it is one line that changes, cut at the terminal's width, unless it is `verbose`.
    """

    def __init__(self, names: tuple[str, ...], console: Console, verbose: bool = False):
        super().__init__(console, None if verbose else Live(self, console=console), "starting")
        self.names, self.shown_at, self.stepped_at = names, 0.0, self.began
        self.last: FitStep | None = None

    def phase(self, words: str) -> None:
        now = time.monotonic()
        is_new = words.split(",")[0] != self.words.split(",")[0]
        self.words = words
        if self.display:
            self.display.refresh()
        elif is_new or now - self.shown_at > SECONDS_BETWEEN:
            self.shown_at = now
            self.say(f"{now - self.began:.1f} s  {words}")

    def step(self, step: FitStep) -> None:
        self.last, self.stepped_at = step, time.monotonic()
        if not self.display:
            self.say("  ".join([f"{self.stepped_at - self.began:.1f} s", *_place(step), *self._values(step)]))

    def __rich__(self) -> Text:
        """The line as it is now."""
        # The values come first, for what is last may be cut.
        where = [*self._values(self.last), *_place(self.last)] if self.last else []
        line = Text("  ".join([f"{time.monotonic() - self.began:.1f} s", self.words, *where]), no_wrap=True)
        # A console that wraps nothing cuts nothing either.
        line.truncate(self.console.width, overflow="ellipsis")
        return line

    def _values(self, step: FitStep) -> list[str]:
        return [f"{name} {value:.7g}" for name, value in zip(self.names, step.value, strict=True)]


def _place(step: FitStep) -> list[str]:
    number = f"{step.step}{'' if step.accepted else ' (rejected)'}"
    return [f"start {step.candidate + 1}", f"blur {step.blur:g} px", f"step {number}", f"cost {step.cost:.6g}"]
