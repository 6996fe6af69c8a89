"""Records of a training: metrics.jsonl, a picture of the curves, TensorBoard events."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from advdiff_sumo.core.whole_file import whole_file

Record = dict[str, Any]
"""One epoch: {"epoch": 1, "step": 100, "train": {"loss": …}, "held_out": {"loss": …}}."""


class Events(Protocol):
    """The part of a TensorBoard writer that is used."""

    def add_scalar(self, tag: str, scalar_value: float, global_step: int) -> None:
        """Write one figure."""
        ...

    def close(self) -> None:
        """Flush and close."""
        ...


class NoEvents:
    """Used if the package tensorboard is not installed."""

    def add_scalar(self, tag: str, scalar_value: float, global_step: int) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


def open_events(folder: Path, step: int) -> Events | None:
    """Return a writer of TensorBoard events, or None if the package is not installed.

    Args:
        folder: of the event files.
        step: steps done before; later events, of an interrupted run, are hidden.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter  # late: an optional package, and slow to import
    except ImportError:
        return None
    writer: Events = SummaryWriter(str(folder), purge_step=step + 1)
    return writer


def write_events(events: Events, record: Record) -> None:
    """Write one epoch's figures."""
    for part in ("train", "held_out"):
        for name, value in record[part].items():
            events.add_scalar(f"{part}/{name}", value, record["step"])


def write_lines(path: Path, history: Sequence[Record]) -> None:
    """Write the whole history, one JSON object a line."""
    with whole_file(path) as aside:
        aside.write_text("".join(json.dumps(r, sort_keys=True) + "\n" for r in history), encoding="utf-8")


def draw_curves(path: Path, title: str, history: Sequence[Record]) -> None:
    """Draw every figure over the epochs as PNG, training and held-out curves in the same panel."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # late: half a second
    from matplotlib.figure import Figure

    names = _names(history)
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(4.2 * columns, 2.8 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    for number, name in enumerate(names):
        axes = figure.add_subplot(rows, columns, number + 1, title=name, xlabel="epoch")
        for part, colour in (("train", "tab:blue"), ("held_out", "tab:orange")):
            points = [(r["epoch"], r[part][name]) for r in history if name in r[part]]
            if points:
                axes.plot(*zip(*points, strict=True), ".-", color=colour, label=part.replace("_", " "))
        axes.grid(alpha=0.3)
        axes.legend(fontsize="x-small")
    with whole_file(path) as aside:
        figure.savefig(aside, format="png", dpi=110, metadata={"Software": None})


def _names(history: Sequence[Record]) -> list[str]:
    parts: list[Mapping[str, float]] = [r[part] for r in history for part in ("train", "held_out")]
    return sorted({name for part in parts for name in part})
