"""The fit as it goes: a live table on a terminal, else a line for each step."""

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from raytrace_jax.inverse.result import FitStep

SECONDS_BETWEEN = 5.0
"""Between two lines on the same kind of phase, where there is no terminal."""


class FitProgress:
    """Shows what a fit is doing, and each of its steps: use it as a context.

    Args:
        names: the free scalar parameters.
        console: where to show it; a quiet console shows nothing.
    """

    def __init__(self, names: tuple[str, ...], console: Console):
        self.names, self.console = names, console
        self.began = time.monotonic()
        self.words, self.shown_at = "starting", 0.0
        self.last: FitStep | None = None
        is_live = console.is_terminal and not console.quiet
        self.live = Live(self._table(), console=console) if is_live else None

    def __enter__(self) -> Self:
        if self.live:
            self.live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.live:
            self.live.stop()

    def phase(self, words: str) -> None:
        """Show what happens now."""
        now = time.monotonic()
        is_new = words.split(",")[0] != self.words.split(",")[0]
        self.words = words
        if self.live:
            self.live.update(self._table(), refresh=True)
        elif is_new or now - self.shown_at > SECONDS_BETWEEN:
            self.shown_at = now
            self.console.print(f"{now - self.began:.1f} s  {words}", highlight=False)

    def step(self, step: FitStep) -> None:
        """Show a step."""
        self.last = step
        if self.live:
            self.live.update(self._table())
        else:
            pieces = (f"{what} {text}" for what, text in self._where(step))
            self.console.print("  ".join([f"{step.seconds:.1f} s", *pieces]), highlight=False)

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        table.add_row(Text(f"{time.monotonic() - self.began:.1f} s", style="dim"), self.words)
        if self.last is not None:
            for what, text in self._where(self.last):
                table.add_row(Text(what, style="dim"), text)
        return table

    def _where(self, step: FitStep) -> list[tuple[str, str]]:
        values = ((name, f"{value:.7g}") for name, value in zip(self.names, step.value, strict=True))
        return [
            ("start", f"{step.candidate + 1}"),
            ("blur", f"{step.blur:g} px"),
            ("step", f"{step.step}{'' if step.accepted else ' (rejected)'}"),
            ("cost", f"{step.cost:.6g}"),
            *values,
        ]
