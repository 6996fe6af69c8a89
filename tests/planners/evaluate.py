"""Print figures of a target over many episodes; no test, run it by hand.

``python -m tests.planners.evaluate --net networks/downtown.net.xml --target lane_graph IDM --scenes 50``
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from advdiff_sumo.maps import RoadMap

from .harness import drive, outcome, scenes, summary


def main() -> None:
    """Print the outcome of each episode that went wrong, and the totals of every target."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--net", type=Path, required=True)
    parser.add_argument("--target", nargs="+", default=["lane_graph", "IDM"])
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--horizon", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--demand", type=Path)
    args = parser.parse_args()
    road = RoadMap.read(args.net)
    starts = list(scenes(road, args.seed, args.scenes, args.horizon, args.demand))
    for target in args.target:
        outcomes = []
        for start in starts:
            outcomes.append(outcome(*drive(road, start, target, args.horizon), road))
            if outcomes[-1].struck or outcomes[-1].failure or outcomes[-1].stood_s > 25.0:
                sys.stdout.write(f"{outcomes[-1]}\n")
                sys.stdout.flush()
        sys.stdout.write(f"{target} on {road.name}\n{summary(outcomes)}\n")


if __name__ == "__main__":
    main()
