"""Drive random traffic over a net and count faults: `python tools/drive_net.py NET --vehicles 300`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from advdiff_sumo.sim.driving_test import driving_test


def main() -> None:
    """Run the driving test and print its figures as JSON."""
    parser = argparse.ArgumentParser(description="Drive random traffic over a net; print figures as JSON.")
    parser.add_argument("net", type=Path)
    parser.add_argument("--end", type=float, default=3600.0, help="seconds to simulate")
    parser.add_argument("--vehicles", type=int, default=300, help="how many set out, evenly over that time")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    figures = driving_test(options.net, vehicles=options.vehicles, duration_s=options.end, seed=options.seed)
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
