"""Show the progress of a run: a bar in a terminal, a line of HTML in a notebook, nothing in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any, Self

from rich.progress import Progress as Bar

from advdiff_sumo.cli.terminal import progress_bar, terminal
from advdiff_sumo.core.wording import counted


class NotebookProgress:
    """Counts episodes and collisions while the block runs."""

    def __init__(self, total: int, wanted: bool) -> None:
        self.total, self.done, self.hits = total, 0, 0
        self._bar: Bar | None = None
        self._html: Any = None
        if wanted and in_notebook():
            self._html = _display(self._line())
        elif wanted and sys.stderr.isatty():
            self._bar = progress_bar(terminal(stderr=True), transient=True)

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
            self._bar.add_task("episodes", total=self.total)
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def on_episode(self, row: Mapping[str, Any] | None, _failed: object = None) -> None:
        """Count an episode that has ended, and its collision if *row* has one; *row* is None for a failed episode."""
        self.done += 1
        self.hits += bool(row and row["target_collision"])
        if self._bar is not None:
            self._bar.update(
                self._bar.task_ids[0], advance=1, description=f"episodes · {counted(self.hits, 'collision')}"
            )
        if self._html is not None:
            self._html.update(_html(self._line()))

    def _line(self) -> str:
        bar = f"<progress max='{self.total}' value='{self.done}'></progress>"
        return f"{bar} {self.done} of {self.total} episodes · {counted(self.hits, 'collision')}"


def in_notebook() -> bool:
    """Return whether this runs in a kernel that shows HTML."""
    if "IPython" not in sys.modules:
        return False
    shell = sys.modules["IPython"].get_ipython()
    return shell is not None and hasattr(shell, "kernel")


def _display(line: str) -> Any:
    from IPython.display import display

    return display(_html(line), display_id=True)


def _html(line: str) -> Any:
    from IPython.display import HTML

    return HTML(line)
