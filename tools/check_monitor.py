"""Compare safe distances and speed limits with CommonRoad's rule monitor on exported scenes.

python tools/check_monitor.py FOLDER --python ENV/bin/python [--net motorway] [--scenes 50] [--keep DIR]

ENV is an environment with commonroad-stl-monitor 2025.1.1, commonroad-io 2024.3 and antlr4-python3-runtime 4.9.3, whose
version constraints are incompatible with this project. Episodes of FOLDER are exported as CommonRoad scenarios. At
every instant, two predicates of the monitor are compared with ours: R_G1 (safe distance of the target, with our
response time and deceleration; cut-ins are not excused) and R_G3 (speed limit of the lane, all vehicles). R_G2,
unnecessary braking, is not a breach here. With --keep, the monitor's answers are stored and used by later calls.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from advdiff_sumo.cli.export import stem_of
from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import InputError
from advdiff_sumo.core.frames import bumper_from_centre
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.experiments.judge_folder import open_judging
from advdiff_sumo.export import ExportScene, make_exporter
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.following import following_gaps
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.metrics.traffic_view import TrafficView

RULES = Path(__file__).with_name("commonroad_rules.py")
Answers = dict[str, Any]
CLOSE_M, TOUCHING_M = 0.5, 0.2
ACROSS = "its box reaches into the lane, its centre is in another one"
CLOSE = f"within {CLOSE_M} m of the safe gap"
TOUCHING = "they touch: the monitor calls nobody ahead then"
OTHER = "something else"


def main() -> int:
    """Print the agreement on each rule; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="finished run or sweep")
    parser.add_argument("--python", required=True, help="interpreter of the monitor's environment")
    parser.add_argument("--net", default="", help="only episodes on nets whose file's name begins so")
    parser.add_argument("--scenes", type=int, default=50, help="how many episodes")
    parser.add_argument("--keep", type=Path, help="folder for the exported scenes and the monitor's answers")
    given = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory() as scratch:
            keep = given.keep or Path(scratch)
            keep.mkdir(parents=True, exist_ok=True)
            counts, failed = compared(given, keep)
    except (InputError, OSError) as error:
        print(f"check_monitor: {error}", file=sys.stderr)
        return 2
    for reason in failed:
        print(f"left out: {reason}")
    for rule in ("safe distance", "speed limit"):
        both, ours, theirs, neither = (
            counts[rule, a, b] for a, b in ((True, True), (True, False), (False, True), (False, False))
        )
        total = both + ours + theirs + neither
        print(f"{rule}: {total} instants, {(both + neither) / max(total, 1):.2%} agree")
        print(f"    broken by both {both}, by ours alone {ours}, by the monitor's alone {theirs}")
    on, off = counts["on a junction", True, True], counts["on a junction", False, True]
    print(f"    of the monitor's alone: a bumper on a lane of a junction {on}, not so {off}")
    print("where they differ on the safe distance:")
    for reason in (ACROSS, CLOSE, TOUCHING, OTHER):
        print(
            f"    {reason}: ours alone {counts[reason, True, False]}, the monitor's {counts[reason, False, True]}"
        )
    return 0


def compared(given: argparse.Namespace, keep: Path) -> tuple[Counter[tuple[str, bool, bool]], list[str]]:
    """Return counts by (rule or reason, broken by ours, broken by the monitor's), and why scenes were left out."""
    scenes = list(islice(moving(given.folder, given.net), given.scenes))
    exporter, stem = make_exporter("commonroad"), stem_of(given.folder)
    paths = []
    for key, record, road in scenes:
        scene = ExportScene(f"{stem}-{key}", record.tracks, record.target, road)
        paths += exporter.write(scene, keep)
    answers = monitored(given.python, paths, keep)
    counts: Counter[tuple[str, bool, bool]] = Counter()
    failed = []
    for (_, record, road), path in zip(scenes, paths, strict=True):
        answer = answers.get(str(path), {"failed": "no answer"})
        if "failed" in answer:
            failed.append(f"{path.name}: {answer['failed']}")
        else:
            add_counts(counts, record, road, answer, obstacles(path))
    return counts, failed


def moving(folder: Path, net: str) -> Iterator[tuple[str, EpisodeRecord, RoadMap]]:
    """Yield key, record and map of the episodes of *folder* on nets whose file name begins with *net*."""
    for key, stored in open_judging(folder).episodes():
        record = stored.record() if stored.net.name.startswith(net) else None
        if record is not None and record.tracks.steps > 1:
            yield key, record, stored.road()


def obstacles(path: Path) -> dict[str, str]:
    """Return number → name of the obstacles in the scenario *path*; the target's name is "target"."""
    pattern = r'<dynamicObstacle id="(\d+)">\s*<!--\s*(target|agent): (.*?)\s*-->'
    matches = re.findall(pattern, path.read_text(encoding="utf-8"))
    return {number: "target" if role == "target" else unquote(name) for number, role, name in matches}


def monitored(python: str, paths: list[Path], keep: Path) -> dict[str, Answers]:
    """Return the monitor's answers by file; those stored in *keep* are used, new ones are added there."""
    store = keep / "answers.jsonl"
    known = [json.loads(line) for line in store.read_text().splitlines()] if store.exists() else []
    answers = {answer["path"]: answer for answer in known}
    unanswered = [path for path in paths if str(path) not in answers]
    arguments = [text for path in unanswered for text in (str(path), target_number(path))]
    with store.open("a") as file:
        command = [python, str(RULES), *arguments]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for line in process.stdout or ():
            if line.startswith("{"):
                answer = json.loads(line)
                answers[answer["path"]] = answer
                file.write(line)
                file.flush()
        process.wait()
    return answers


def target_number(path: Path) -> str:
    """Return the number of the target in the scenario *path*."""
    return next(number for number, name in obstacles(path).items() if name == "target")


def add_counts(
    counts: Counter[tuple[str, bool, bool]],
    record: EpisodeRecord,
    road: RoadMap,
    answers: Answers,
    names: dict[str, str],
) -> None:
    """Add the instants of one scene to *counts*.

    Args:
        counts: by (rule or reason, broken by ours, broken by the monitor's).
        record: of the scene.
        road: its map.
        answers: those of the monitor.
        names: number → name of the obstacles.
    """
    tracks, target = record.tracks, record.target
    view = TrafficView.of_record(record, road)
    ahead = following_gaps(tracks, target, road, record.route)
    speed = tracks.speed_mps[target]
    spare_m = ahead.gap_m - safe_gap_m(speed + 0.0 * ahead.gap_m, speed - ahead.closing_mps)
    for step in answers["steps"]:
        ours = {tracks.ids[row] for row in np.flatnonzero(spare_m[:, step] < 0.0).tolist()}  # NaN: not ahead
        theirs = {names[str(number)] for number in answers["unsafe"].get(str(step), ())}
        counts["safe distance", bool(ours), bool(theirs)] += 1
        if bool(ours) != bool(theirs):
            rows = [tracks.index[name] for name in ours | theirs]
            counts[why_apart(spare_m[rows, step], ahead.gap_m[rows, step]), bool(ours), bool(theirs)] += 1
    for number, steps in answers["too_fast"].items():
        row = target if names[number] == "target" else tracks.index[names[number]]
        limits, too_fast_steps = road.legal_limits_mps, set(steps)
        for step in np.flatnonzero(tracks.valid[row]).tolist():
            lane = view.place(row, step, step + 1).lane[0]
            is_fast = lane is not None and tracks.speed_mps[row, step] > limits[lane]
            counts["speed limit", bool(is_fast), step in too_fast_steps] += 1
            if step in too_fast_steps and not is_fast:
                counts["on a junction", on_junction(tracks, row, step, road), True] += 1


def on_junction(tracks: Tracks, row: int, step: int, road: RoadMap) -> bool:
    """Return whether the front or rear bumper of agent *row* is on a lane of a junction."""
    yaw, length_m = tracks.yaw_rad[row, step], tracks.size_m[row, 0]
    front = bumper_from_centre(tracks.xy_m[row, step], yaw, length_m)
    rear = bumper_from_centre(tracks.xy_m[row, step], yaw, -length_m)
    poses = [road.locate(bumper, yaw) for bumper in (front, rear)]
    return any(pose is not None and road.lanes[pose.lane_id].is_internal for pose in poses)


def why_apart(spare_m: FloatArray, gap_m: FloatArray) -> str:
    """Return why we and the monitor disagree on the safe distance.

    Args:
        spare_m: gap minus safe gap to each vehicle that either of us reports; NaN if we do not consider it ahead in the
            lane.
        gap_m: the gaps; NaN as above.
    """
    if np.isnan(spare_m).all():
        return ACROSS
    if np.nanmin(gap_m) < TOUCHING_M:
        return TOUCHING
    return CLOSE if np.nanmin(np.abs(spare_m)) < CLOSE_M else OTHER


if __name__ == "__main__":
    sys.exit(main())
