"""How many collisions the reference drivers avoid, by how long before the contact they take over at the earliest.

python tools/lookback_sensitivity.py FOLDER ... [--lookback 2 3 5]

Judges the collisions of the target with others in finished runs or sweeps, whose rows are left as they are.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from advdiff_sumo.core.errors import InputError
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.experiments.judge_folder import open_judging
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches.striking_rules import pushed_by
from advdiff_sumo.metrics.collision import Collision, collisions, target_collision
from advdiff_sumo.metrics.encounter import encounter_of
from advdiff_sumo.metrics.reference import MODELS, drive_all
from advdiff_sumo.metrics.traffic_view import TrafficView
from advdiff_sumo.metrics.verdict import avoids


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
                counts.update(avoiding(record, road, struck, given.lookback))
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
    for _, stored in open_judging(folder).episodes():
        if not stored.row["collision_partner"]:
            continue
        record = stored.record()
        struck = None if record is None else target_collision(record, collisions(record))
        if record is not None and struck is not None and struck.step > 0:
            yield record, stored.road(), struck


def avoiding(
    record: EpisodeRecord, road: RoadMap, struck: Collision, lookbacks_s: Sequence[float]
) -> Iterator[tuple[float, str]]:
    """Yield each look-back with each model that avoids the collision then, as the verdict says it."""
    view = TrafficView.of_record(record, road)
    pusher = pushed_by(view, encounter_of(view, struck), 0)
    for lookback_s in lookbacks_s:
        for model, drive in drive_all(record, road, struck, lookback_s=lookback_s).items():
            if avoids(record, struck, drive, pusher):
                yield lookback_s, model


if __name__ == "__main__":
    sys.exit(main())
