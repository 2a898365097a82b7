"""The fit as it goes: a live table on a terminal, else a line for each step."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from raytrace_jax.inverse.result import FitStep


class FitProgress:
    """Shows each step of a fit: use it as a context, and call it with the steps.

    Args:
        names: the free scalar parameters.
        levels: how many levels the pyramid has.
        console: where to show it; a quiet console shows nothing.
    """

    def __init__(self, names: tuple[str, ...], levels: int, console: Console):
        self.names = names
        self.levels = levels
        self.console = console
        waiting = Text(f"compiling for {len(names)} free parameters ...")
        is_live = console.is_terminal and not console.quiet
        self.live = Live(waiting, console=console) if is_live else None
        if not is_live:
            console.print(waiting)

    def __enter__(self) -> Self:
        if self.live:
            self.live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.live:
            self.live.stop()

    def __call__(self, step: FitStep) -> None:
        """Show a step."""
        if self.live:
            self.live.update(self._table(step))
        else:
            self.console.print(self._line(step))

    def _where(self, step: FitStep) -> tuple[tuple[str, str], ...]:
        return (
            ("level", f"{step.level + 1}/{self.levels}"),
            ("blur", f"{step.blur:g} px"),
            ("step", f"{step.step}{'' if step.accepted else ' (rejected)'}"),
            ("cost", f"{step.cost:.6g}"),
            ("time", f"{step.seconds:.1f} s"),
        )

    def _line(self, step: FitStep) -> str:
        values = (f"{name}={value:.7g}" for name, value in zip(self.names, step.value, strict=True))
        return "  ".join([*(f"{what} {text}" for what, text in self._where(step)), *values])

    def _table(self, step: FitStep) -> Table:
        table = Table.grid(padding=(0, 2))
        for what, text in self._where(step):
            table.add_row(Text(what, style="dim"), text)
        for name, value in zip(self.names, step.value, strict=True):
            table.add_row(name, Text(f"{value:.7g}", style="bold"))
        return table
