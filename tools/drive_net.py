"""Drives random traffic over a net and counts what went wrong: `python tools/drive_net.py NET --period 1.5`."""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import sumolib
from defusedxml import ElementTree

RULES = (
    "--step-length=0.1",
    "--lateral-resolution=0.4",
    "--collision.action=warn",
    "--collision.check-junctions=true",
    "--collision.mingap-factor=0",
    "--time-to-teleport=120",
    "--no-step-log=true",
    "--xml-validation=never",
    "--duration-log.statistics=true",
)


def random_routes(net: Path, folder: Path, end_s: float, period_s: float, seed: int) -> Path:
    """Trips that mostly begin and end at the fringe, as routes."""
    trips, routes = folder / "trips.xml", folder / "routes.rou.xml"
    script = Path(sumolib.__file__).parents[1] / "sumo" / "tools" / "randomTrips.py"
    command = [sys.executable, str(script), "-n", str(net), "-o", str(trips), "-r", str(routes)]
    command += ["-e", str(end_s), "-p", str(period_s), "--fringe-factor", "10", "--seed", str(seed)]
    command += ["--min-distance", "250", "--validate", "--random-depart", "--lanes", "--speed-exponent", "1"]
    command += ["--trip-attributes", 'departLane="best" departSpeed="max" departPos="base"']
    subprocess.run(command, check=True, capture_output=True)
    return routes


def drive(net: Path, routes: Path, folder: Path, end_s: float, seed: int) -> dict[str, float | list[str]]:
    """Run SUMO; returns counts of events and the state of the traffic."""
    log, stats, summary = folder / "log.txt", folder / "stats.xml", folder / "summary.xml"
    command = [sumolib.checkBinary("sumo"), "-n", str(net), "-r", str(routes), f"--seed={seed}", *RULES]
    command += [
        f"--end={end_s}",
        f"--log={log}",
        f"--statistic-output={stats}",
        f"--summary-output={summary}",
    ]
    subprocess.run(command, check=True, capture_output=True)
    root = _root(stats)
    steps = [step.attrib for step in _root(summary)]
    running, halting = ([int(step[key]) for step in steps] for key in ("running", "halting"))
    trips, vehicles, safety, teleports = (
        root.find(key).attrib for key in ("vehicleTripStatistics", "vehicles", "safety", "teleports")
    )
    warnings = [
        w
        for w in re.findall(r"Warning: (.*)", log.read_text())
        if any(k in w for k in ("Teleport", "colli", "emergency"))
    ]
    return {
        "inserted": float(vehicles.get("inserted", 0)),
        "waiting": float(vehicles.get("waiting", 0)),
        "most_running": max(running),
        "running_at_end": running[-1],
        "halting_at_end": halting[-1],
        "mean_speed_mps": float(trips.get("speed", 0)),
        "mean_time_loss_s": float(trips.get("timeLoss", 0)),
        "teleports": float(teleports.get("total", 0)),
        "collisions": float(safety.get("collisions", 0)),
        "emergency_stops": float(safety.get("emergencyStops", 0)),
        "emergency_braking": float(safety.get("emergencyBraking", 0)),
        "warnings": warnings,
    }


def _root(file: Path) -> Any:
    return ElementTree.parse(file).getroot()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Drive random traffic over a net; print figures as JSON.")
    parser.add_argument("net", type=Path)
    parser.add_argument("--end", type=float, default=3600.0, help="seconds to simulate")
    parser.add_argument("--period", type=float, default=1.5, help="seconds between departures")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        routes = random_routes(options.net, folder, options.end, options.period, options.seed)
        print(json.dumps(drive(options.net, routes, folder, options.end, options.seed), indent=1))


if __name__ == "__main__":
    main()
