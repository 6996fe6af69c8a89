"""What ``run --check`` prints: which background vehicle did what."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table

from advdiff_sumo.core.record import Controller, EndReason, EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.plausibility import Implausibility, implausibilities
from advdiff_sumo.report.states import states_of


def print_check(console: Console, folder: Path, road: RoadMap) -> None:
    """Print what background vehicles that the policy moved did in the run in *folder*."""
    states = pq.read_table(folder / "states.parquet")
    found: list[tuple[int, Implausibility]] = []
    driven = 0
    episodes = np.asarray(states["episode"].to_numpy(), dtype=np.int64)
    for number in np.unique(episodes).tolist():
        record = _record(states.filter(pa.array(episodes == number)), number)
        if record is not None:
            driven += int((record.controller == Controller.POLICY).any(axis=1).sum())
            found += [(number, x) for x in implausibilities(record, road)]
    if found:
        console.print(_table(found))
    vehicles = len({(number, x.vehicle) for number, x in found})
    console.print(f"check: {vehicles} of {driven} vehicles that the policy moved did something implausible")


def _record(part: pa.Table, number: int) -> EpisodeRecord | None:
    """Return what the rows of one episode of ``states.parquet`` tell; None without a target."""
    states = states_of(part)
    if states is None:
        return None
    controller = np.full(states.tracks.valid.shape, Controller.ABSENT, dtype=np.int64)
    columns = (part[name].to_pylist() for name in ("agent", "step", "controller"))
    for name, step, who in zip(*columns, strict=True):
        controller[states.tracks.index[name], step] = Controller[who.upper()]
    return EpisodeRecord(
        episode=number,
        seed=0,
        scene="",
        tracks=states.tracks,
        target=states.target,
        controller=controller,
        route=(),
        end=EndReason.HORIZON,
    )


def _table(found: list[tuple[int, Implausibility]]) -> Table:
    table = Table(title="what background vehicles did that no vehicle should do", title_justify="left")
    for name in ("episode", "vehicle", "at", "what"):
        table.add_column(name, justify="right" if name in ("episode", "at") else "left")
    for number, x in found:
        whom = f" with {x.other}" if x.other else ""
        table.add_row(str(number), x.vehicle, f"{x.time_s:.1f} s", f"{x.what}{whom}: {x.value:.1f} {x.unit}")
    return table
