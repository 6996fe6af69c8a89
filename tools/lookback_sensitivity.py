"""How many collisions the reference drivers avoid, by how long before the contact they take over at the earliest.

python tools/lookback_sensitivity.py FOLDER ... [--lookback 2 3 5]

Judges the collisions of the target with others in finished runs or sweeps, whose rows are left as they are.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from advdiff_sumo.core.errors import InputError
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.experiments.judge_folder import open_folder
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches.striking_rules import pushed_by
from advdiff_sumo.metrics.collision import Collision, collisions, target_collision
from advdiff_sumo.metrics.encounter import encounter
from advdiff_sumo.metrics.reference import MODELS, drive_all
from advdiff_sumo.metrics.traffic_view import TrafficView
from advdiff_sumo.metrics.verdict import avoids
from advdiff_sumo.report.stored_record import stored_record


def main() -> int:
    """Print a row a look-back; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+", help="finished runs or sweeps")
    parser.add_argument("--lookback", type=float, nargs="+", default=[2.0, 3.0, 5.0], help="in seconds")
    given = parser.parse_args()
    counts: Counter[tuple[float, str]] = Counter()
    total = 0
    try:
        for folder in given.folders:
            for record, road, struck in struck_targets(folder):
                total += 1
                for lookback_s in given.lookback:
                    counts.update((lookback_s, model) for model in avoiding(record, road, struck, lookback_s))
    except InputError as error:
        print(f"lookback_sensitivity: {error}", file=sys.stderr)
        return 2
    print(f"{total} collisions; avoided with so many seconds of look-back")
    print(f"{'s':>4}" + "".join(f"{model:>17}" for model in MODELS))
    for lookback_s in given.lookback:
        print(f"{lookback_s:>4g}" + "".join(f"{counts[lookback_s, model]:>17}" for model in MODELS))
    return 0


def struck_targets(folder: Path) -> Iterator[tuple[EpisodeRecord, RoadMap, Collision]]:
    """Yield the records of *folder* in which the target collides with another after the first instant."""
    roads: dict[Path, RoadMap] = {}
    for _, stored in open_folder(folder).episodes():
        if not stored.row["collision_partner"]:
            continue
        record = stored_record(stored.states, stored.row, stored.signals)
        struck = None if record is None else target_collision(record, collisions(record))
        if record is not None and struck is not None and struck.step > 0:
            if stored.net not in roads:
                roads[stored.net] = RoadMap.read(stored.net)
            yield record, roads[stored.net], struck


def avoiding(record: EpisodeRecord, road: RoadMap, struck: Collision, lookback_s: float) -> list[str]:
    """Return the models that avoid the collision, as the verdict says it."""
    view = TrafficView.of_record(record, road)
    pusher = pushed_by(view, encounter(view, struck), 0)
    drives = drive_all(record, road, struck, lookback_s=lookback_s)
    return [model for model, drive in drives.items() if avoids(record, struck, drive, pusher)]


if __name__ == "__main__":
    sys.exit(main())
