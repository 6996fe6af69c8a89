"""A run folder of three hand-made encounters: a valid failure, a red-light runner, a critical near miss."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row
from advdiff_sumo.sim.episode import Timing
from advdiff_sumo.sim.run_store import episode_tables
from advdiff_sumo.sweep.run_folder import RunFolder
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from tests.metrics.encounters import braking, crossing, driven, record_of, signals_of, straight

STEPS = 61


def encounter_folder(place: Path) -> Path:
    """Write the folder ``run`` and its net into *place*."""
    road = crossing(place, "traffic_light")
    t = 0.1 * np.arange(STEPS)
    late = (
        straight("ego", (-150, -1.6), 0, 12, STEPS),
        driven("lead", (-116, -1.6), 0, braking(12, 0.5, 3.0, STEPS)),
    )
    red = straight("east", (-30, -1.6), 0, 10, STEPS), straight("north", (1.6, -31), 0.5 * math.pi, 10, STEPS)
    near = (
        driven("ego", (-150, -4.8), 0, np.maximum(5.0, 14.0 - 9.0 * np.maximum(0.0, t - 0.2))),
        driven("cutter", (-138, -1.6), 0, np.full(STEPS, 6.0), left=np.maximum(-3.2, -4.0 * t)),
    )
    lights = signals_of(road, {("WC_1", "CE_1"): "G", ("SC_0", "CN_0"): "r"}, STEPS)
    options = {"net": str(road.path), "episodes": 3, "target": "mine", "background": "hand", "seed": 1}
    folder = RunFolder.create(place / "run", {"options": options}, False)
    for number, crew in enumerate((late, red, near)):
        record = record_of(*crew, signals=lights, episode_number=number)
        rows = episode_row(record, road), collision_rows(record, road)
        folder.add(number, StoredEpisode(episode_tables(record, *rows, Timing(1.0, (), ())), None))
    folder.consolidate(finished=True)
    return folder.path
