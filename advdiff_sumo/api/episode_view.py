"""Show one episode of a run or sweep, as a figure or in a player."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from advdiff_sumo.report.folder import FinishedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_REPR_COLUMNS = (
    "end",
    "collision_type",
    "at_fault",
    "min_ttc_s",
    "min_clearance_m",
    "failure_kind",
    "failure_message",
)


@dataclass(frozen=True)
class Player:
    """The report's player of one episode; shown inline in a notebook.

    Attributes:
        page: HTML without external files.
    """

    page: str

    def _repr_html_(self) -> str:
        return framed(self.page, 620)


@dataclass(frozen=True)
class EpisodeView:
    """One episode of a run or sweep; shown as a film strip in a notebook.

    Attributes:
        run: the run or sweep.
        row: its row of ``episodes.parquet``.
    """

    run: FinishedRun
    row: Mapping[str, Any]

    @property
    def number(self) -> int:
        """The episode's number."""
        return int(self.row["episode"])

    def figure(self, panels: int = 4, start_s: float | None = None, end_s: float | None = None) -> Figure:
        """Return *panels* moments side by side as a figure of matplotlib.

        Args:
            panels: how many, 1 to 8.
            start_s: first moment; by default 6 s before the last.
            end_s: last moment; by default the contact, or 1 s after the smallest distance.

        Raises:
            FileError: there are no states of the episode.
            ConfigError: the number of panels is out of range, or the time span is not in the episode.
        """
        from advdiff_sumo.report.strip import strip_figure

        return strip_figure(self.run.folder, self.number, panels, start_s, end_s)

    def player(self) -> Player:
        """Return a player with synchronous charts."""
        from advdiff_sumo.report.page import report_html

        return Player(report_html(self.run.only(self.number)))

    def __repr__(self) -> str:
        facts = (
            f"{name} {_value_text(self.row[name])}"
            for name in _REPR_COLUMNS
            if self.row.get(name) not in (None, "")
        )
        return f"episode {self.number}: {', '.join(facts)}"

    def _repr_html_(self) -> str:
        facts = f"<p>{html.escape(repr(self))}</p>"
        states = self.run.states(self.number)
        if states is None or states.tracks.steps < 2:  # it failed before its first step: nothing to draw
            return facts
        picture = io.BytesIO()
        self.figure().savefig(picture, format="png")
        encoded = base64.b64encode(picture.getvalue()).decode()
        return f"{facts}<img src='data:image/png;base64,{encoded}' style='max-width:100%'>"


def _value_text(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def framed(page: str, height: int) -> str:
    """Return *page* as an iframe for a notebook, so that the styles of page and notebook do not mix."""
    attributes = f"width='100%' height='{height}' style='border:1px solid #ccc'"
    return f'<iframe {attributes} srcdoc="{html.escape(page, quote=True)}"></iframe>'
