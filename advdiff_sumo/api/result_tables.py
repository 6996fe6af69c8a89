"""Read the results of a run or sweep in a script, and show them in a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa

from advdiff_sumo.api.episode_view import EpisodeView, framed
from advdiff_sumo.core.errors import FileError, MissingExtraError
from advdiff_sumo.core.wording import counted
from advdiff_sumo.data.run_tables import RunTables
from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.run_summary import summary_figures, summary_lines


@dataclass(frozen=True)
class Summary:
    """Main figures of a run as text; a table in a notebook.

    Attributes:
        lines: (name, value with unit).
        figures: the numbers behind them.
    """

    lines: tuple[tuple[str, str], ...]
    figures: dict[str, Any]

    def __repr__(self) -> str:
        width = max(len(name) for name, _ in self.lines)
        return "\n".join(f"{name:<{width}}  {value}" for name, value in self.lines)

    def _repr_html_(self) -> str:
        rows = (f"<tr><th>{html.escape(n)}</th><td>{html.escape(v)}</td></tr>" for n, v in self.lines)
        return f"<table>{''.join(rows)}</table>"


@dataclass(frozen=True)
class ReportPage:
    """The report page of a run; shown inline in a notebook.

    Attributes:
        path: the file, which needs no other file.
    """

    path: Path

    def _repr_html_(self) -> str:
        return framed(self.path.read_text(encoding="utf-8"), 700)


@dataclass(frozen=True)
class Results:
    """The folder of a finished run or sweep.

    Attributes:
        folder: its path.
    """

    folder: Path

    @cached_property
    def finished(self) -> FinishedRun:
        """The content of the folder, as the report reads it."""
        return FinishedRun.read(self.folder)

    def table(self, name: str = "episodes") -> pa.Table:
        """Return ``NAME.parquet`` of the folder; ``docs/outputs.md`` lists names and columns.

        Raises:
            FileError: there is no such table.
        """
        tables = RunTables(self.folder)
        path = tables.path(name)
        if not path.exists():
            names = ", ".join(sorted(p.stem for p in self.folder.glob("*.parquet")))
            raise FileError(path, "no such table", f"known are: {names}")
        return tables.rows(name)

    @property
    def episodes(self) -> pa.Table:
        """Table with one row for each episode."""
        return self.table("episodes")

    def to_pandas(self, name: str = "episodes") -> Any:
        """Return a table as a data frame.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        try:
            return self.table(name).to_pandas()
        except ModuleNotFoundError:
            raise MissingExtraError("a data frame", "pandas") from None

    def summary(self) -> Summary:
        """Return rates with intervals, medians, planning times, and the reasons why episodes failed."""
        tables, timing = RunTables(self.folder), self.table("timing").to_pylist()
        rows = tables.all_episodes()
        failed = {
            str(row["failure_kind"]): str(row["failure_message"])
            for row in reversed(rows)
            if row["failure_kind"]
        }
        reasons = [(f"… the first {kind}", message) for kind, message in sorted(failed.items())]
        return Summary((*summary_lines(rows, timing, tables.situation()), *reasons), summary_figures(rows))

    def report(self) -> ReportPage:
        """Write ``report.html`` into the folder and return it."""
        from advdiff_sumo.report.page import write_report

        return ReportPage(write_report(self.folder))

    def episode(self, number: int) -> EpisodeView:
        """Return one episode.

        Raises:
            FileError: there is none of that number.
        """
        return EpisodeView(self.finished, self.finished.row(number))

    def worst(self) -> EpisodeView:
        """Return the episode that the report shows first.

        Raises:
            FileError: there is no episode.
        """
        return EpisodeView(self.finished, self.finished.worst_row())

    def __len__(self) -> int:
        return len(self.finished.episodes)

    def __iter__(self) -> Iterator[EpisodeView]:
        return (EpisodeView(self.finished, row) for row in self.finished.episodes)

    def __repr__(self) -> str:
        return f"{self.folder}: {counted(len(self), 'episode')}\n{self.summary()!r}"

    def _repr_html_(self) -> str:
        worst = self.worst()._repr_html_() if len(self) else ""
        return f"<p><code>{html.escape(str(self.folder))}</code></p>{self.summary()._repr_html_()}{worst}"


def load(folder: str | Path) -> Results:
    """Return the results in the folder of a run or sweep, which may have been interrupted.

    Raises:
        FileError: it is no such folder, or a file in it is damaged.
    """
    from advdiff_sumo.experiments.folder_rows import put_together  # late: the results of run() do not need it

    put_together(Path(folder))
    results = Results(Path(folder))
    _ = results.finished
    return results
