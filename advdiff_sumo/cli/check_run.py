"""Output of ``run --check``: implausible behaviour of background vehicles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
from rich.console import Console
from rich.table import Table

from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.wording import counted
from advdiff_sumo.data.run_tables import RunTables
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.plausibility import Implausibility, implausibilities
from advdiff_sumo.report.stored_record import stored_record


def print_check(console: Console, folder: Path, road: RoadMap) -> None:
    """Print the implausible behaviour of vehicles moved by the policy in the run in *folder*, on the net *road*."""
    states = RunTables(folder).rows("states")
    findings: list[tuple[int, Implausibility]] = []
    moved = 0
    episodes = np.asarray(states["episode"].to_numpy(), dtype=np.int64)
    for number in np.unique(episodes).tolist():
        record = stored_record(states.filter(pa.array(episodes == number)))
        if record is not None:
            moved += int((record.controller == Controller.POLICY).any(axis=1).sum())
            findings += [(number, x) for x in implausibilities(record, road)]
    if findings:
        console.print(_table(findings))
    vehicles = len({(number, x.vehicle) for number, x in findings})
    console.print(f"check: {vehicles} of {moved} vehicles that the policy moved did something implausible")
    rows = RunTables(folder).rows("episodes")
    changed, plans = (int(np.nansum(rows[name].to_numpy())) for name in ("safeguarded_plans", "moved_plans"))
    if plans:
        console.print(
            f"check: the safeguard changed what is driven next of {changed / plans:.1%} of {counted(plans, 'plan')}"
        )


def _table(findings: list[tuple[int, Implausibility]]) -> Table:
    table = Table(title="what background vehicles did that no vehicle should do", title_justify="left")
    for name in ("episode", "vehicle", "at", "what"):
        table.add_column(name, justify="right" if name in ("episode", "at") else "left")
    for number, x in findings:
        whom = f" with {x.other}" if x.other else ""
        table.add_row(str(number), x.vehicle, f"{x.time_s:.1f} s", f"{x.what}{whom}: {x.value:.1f} {x.unit}")
    return table
