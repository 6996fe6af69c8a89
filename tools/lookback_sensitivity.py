"""Count the collisions that the reference drivers avoid, by the earliest takeover before the contact (look-back).

python tools/lookback_sensitivity.py FOLDER ... [--lookback 2 3 5]

The tool judges the target's collisions with other road users in finished runs or sweeps, and does not change their
rows.
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
    """Print a row for each look-back; return the exit code."""
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
            for record, road, collision in target_collisions(folder):
                total += 1
                counts.update(avoiding_models(record, road, collision, given.lookback))
    except InputError as error:
        print(f"lookback_sensitivity: {error}", file=sys.stderr)
        return 2
    print(f"{total} collisions; avoided with so many seconds of look-back")
    print(f"{'s':>4}" + "".join(f"{model:>17}" for model in MODELS))
    for lookback_s in given.lookback:
        print(f"{lookback_s:>4g}" + "".join(f"{counts[lookback_s, model]:>17}" for model in MODELS))
    return 0


def target_collisions(folder: Path) -> Iterator[tuple[EpisodeRecord, RoadMap, Collision]]:
    """Yield the records of *folder* in which the target collides with another road user after the first instant."""
    for _, stored in open_judging(folder).episodes():
        if not stored.row["collision_partner"]:
            continue
        record = stored.record()
        collision = None if record is None else target_collision(record, collisions(record))
        if record is not None and collision is not None and collision.step > 0:
            yield record, stored.road(), collision


def avoiding_models(
    record: EpisodeRecord, road: RoadMap, collision: Collision, lookbacks_s: Sequence[float]
) -> Iterator[tuple[float, str]]:
    """Yield (look-back, model) for each model that avoids the collision by the criterion of the verdict."""
    view = TrafficView.of_record(record, road)
    pusher = pushed_by(view, encounter_of(view, collision), 0)
    for lookback_s in lookbacks_s:
        for model, drive in drive_all(record, road, collision, lookback_s=lookback_s).items():
            if avoids(record, collision, drive, pusher):
                yield lookback_s, model


if __name__ == "__main__":
    sys.exit(main())
