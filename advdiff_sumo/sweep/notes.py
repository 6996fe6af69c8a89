"""What a sweep leaves out of its logs and its demand."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

from advdiff_sumo.data import open_log
from advdiff_sumo.sim.demand_files import read_demand
from advdiff_sumo.sim.run_episodes import left_out, read_road
from advdiff_sumo.sweep.job_plan import SweepPlan


def sweep_notes(plan: SweepPlan) -> Iterator[str]:
    """Yield sentences on what of logs and demand is left out, once for each net with its log or demand.

    Raises:
        InputError: a log cannot be read.
    """
    sources = {
        (cell.net, cell.demand, cell.scenes): cell for cell in plan.cells if cell.demand or cell.scenes
    }
    road_of = cache(read_road)  # a net may have several logs and demands
    for (net, demand, scenes), options in sources.items():
        road = road_of(net)
        files = read_demand(Path(demand), road) if demand else None
        yield from left_out(options, road, files, open_log(Path(scenes)) if scenes else None)
