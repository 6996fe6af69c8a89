"""What is judged depends neither on place, clock and step of a record, nor on names, order and bystanders."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from defusedxml.ElementTree import parse

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.core.resample import with_middles
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.metric_rows import Value, episode_row
from advdiff_sumo.sweep.situation import situation
from tests.metrics.constructed_encounters import ENCOUNTERS
from tests.metrics.encounter_casts import Constructed
from tests.metrics.encounters import crossing, record_of, straight
from tests.metrics.test_constructed_encounters import record_for, roundabout

NAMES = (
    "red-light runner",
    "right of way taken",
    "first come at an all-way stop",
    "left turn across oncoming traffic",
    "roundabout entry",
)
CASES = [case for case in ENCOUNTERS if case.name in NAMES]
#: Columns of the place, and an angle that is π as well as −π.
PLACES = ("impact_x_m", "impact_y_m", "approach_yaw_rad")
SIDES = {"from_left": "from_right", "turn_left": "turn_right"}
SIDES |= {right: left for left, right in SIDES.items()}
DIRECTIONS = str.maketrans("lrLRtT", "rlRLTt")


@dataclass(frozen=True)
class Motion:
    """A mirroring at the x axis, then a turn, then a shift."""

    turn_rad: float = 0.0
    shift_m: tuple[float, float] = (0.0, 0.0)
    mirrors: bool = False

    def xy(self, xy_m: FloatArray) -> FloatArray:
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        mirrored = xy_m * (1.0, -1.0 if self.mirrors else 1.0)
        return np.asarray(mirrored @ np.array([[cos, sin], [-sin, cos]]) + self.shift_m)

    def record(self, record: EpisodeRecord) -> EpisodeRecord:
        tracks = record.tracks
        yaw = (-tracks.yaw_rad if self.mirrors else tracks.yaw_rad) + self.turn_rad
        return replace(record, tracks=replace(tracks, xy_m=self.xy(tracks.xy_m), yaw_rad=yaw))

    def net(self, path: Path) -> RoadMap:
        """Return the net at *path*, moved; its left-hand counterpart if mirrored."""
        tree = parse(path)
        for element in tree.iter():
            if shape := element.get("shape"):
                points = self.xy(np.array([x.split(",")[:2] for x in shape.split()], dtype=np.float64))
                element.set("shape", " ".join(f"{x},{y}" for x, y in points.tolist()))
            if element.tag == "junction":
                x, y = self.xy(np.array([float(element.attrib["x"]), float(element.attrib["y"])]))
                element.attrib.update(x=str(x), y=str(y))
            if self.mirrors and element.tag == "connection":
                element.set("dir", element.attrib["dir"].translate(DIRECTIONS))
        if self.mirrors:
            tree.getroot().set("lefthand", "true")
        tree.write(moved := path.with_name("moved.net.xml"))
        return RoadMap.read(moved)


MOTIONS = {
    "turned": Motion(0.7, (12.3, -4.5)),
    "in UTM coordinates": Motion(0.0, (500_000.0, 5_000_000.0)),
    "turned in UTM coordinates": Motion(-1.1, (500_000.0, 5_000_000.0)),
    "mirrored": Motion(mirrors=True),
}


@pytest.fixture(scope="module")
def road_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., RoadMap]:
    """Return a maker of the map of a case, moved by a motion; each is made once."""
    made: dict[tuple[str, Motion], RoadMap] = {}

    def road(net: str, motion: Motion = Motion()) -> RoadMap:
        if (net, motion) not in made:
            folder = tmp_path_factory.mktemp(net)
            plain = roundabout(folder, False) if net == "roundabout" else crossing(folder, net)
            made[net, motion] = plain if motion == Motion() else motion.net(plain.path)
        return made[net, motion]

    return road


def judged(record: EpisodeRecord, road: RoadMap) -> dict[str, Value]:
    """Return the columns of an episode but for those of the place."""
    row = episode_row(record, road)
    row |= situation(record, row, road)
    return {name: value for name, value in row.items() if name not in PLACES}


def agree(row: dict[str, Value], other: dict[str, Value]) -> bool:
    """Return whether two rows are the same up to rounding, that of UTM coordinates included."""
    return row == {
        name: pytest.approx(value, rel=1e-5, abs=1e-5) if isinstance(value, float) else value
        for name, value in other.items()
    }


def with_sides_exchanged(row: dict[str, Value]) -> dict[str, Value]:
    """Return *row* with left and right exchanged."""
    signs = {x: -float(row[x]) for x in ("impact_left_m", "approach_left_m") if row[x] is not None}
    return row | signs | {x: SIDES.get(str(row[x]), row[x]) for x in ("approach", "target_manoeuvre")}


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_place_of_the_scene(road_of, case: Constructed, motion: Motion) -> None:
    road = road_of(case.net)
    record = record_for(case, road, lefthand=False, exchanged=False)
    row, moved = judged(record, road), judged(motion.record(record), road_of(case.net, motion))
    assert row["target_collision"]
    assert agree(with_sides_exchanged(moved) if motion.mirrors else moved, row)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_names_order_and_a_bystander(road_of, case: Constructed) -> None:
    """Somebody 8 km away comes first, the target last, under names in another order."""
    road = road_of(case.net)
    record = record_for(case, road, lefthand=False, exchanged=False)
    steps, target, other = record.tracks.steps, *record.tracks.ids[:2]
    away = record_of(straight("away", (-5000, 7000), 1.0, 10.0, steps)).tracks
    tracks = record.tracks.joined(away).rows(np.arange(record.tracks.agents, -1, -1))
    names = {target: "zz", other: "a"}
    tracks = replace(tracks, ids=tuple(names.get(x, x) for x in tracks.ids))
    controller = np.vstack((record.controller, record.controller[:1]))[::-1]
    changed = replace(record, tracks=tracks, target=record.tracks.agents, controller=controller)
    row = judged(record, road)
    expected = {k: v.replace(f"'{other}'", "'a'") if isinstance(v, str) else v for k, v in row.items()}
    expected |= {k: "a" for k, v in row.items() if k.endswith("partner") and v == other}
    assert agree(judged(changed, road), expected | {"agents": int(row["agents"]) + 1})


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_clock(road_of, case: Constructed) -> None:
    """All times are 37 s later, also those in sentences; nothing else changes."""
    road = road_of(case.net)
    record = record_for(case, road, lefthand=False, exchanged=False)
    row, later = judged(record, road), judged(replace(record, tracks=record.tracks.shifted(37.0)), road)
    told = ("fault_reason", "offences_text")
    times = [name for name in row if name.endswith("_time_s") and row[name] is not None]
    assert "collision_time_s" in times
    row |= {name: float(row[name]) + 37.0 for name in times}
    assert agree({k: v for k, v in later.items() if k not in told}, {k: row[k] for k in row if k not in told})


def at_half_steps(record: EpisodeRecord) -> EpisodeRecord:
    """Return the same motion, with an instant in the middle of each step; all are present."""
    tracks = record.tracks
    xy, yaw = with_middles(tracks.xy_m, tracks.yaw_rad)
    speed = np.repeat(tracks.speed_mps, 2, axis=1)[:, :-1]
    speed[:, 1::2] = 0.5 * (speed[:, :-1:2] + speed[:, 2::2])
    valid = np.ones(yaw.shape, dtype=np.bool_)
    fine = replace(tracks, xy_m=xy, yaw_rad=yaw, speed_mps=speed, valid=valid, dt_s=0.5 * tracks.dt_s)
    signals = tuple(x for x in record.signals for _ in range(2))[: fine.steps]
    controller = np.repeat(record.controller, 2, axis=1)[:, :-1]
    return replace(record, tracks=fine, signals=signals, controller=controller)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_step_of_the_record(road_of, case: Constructed) -> None:
    """Words are the same, and so are time and speed of the contact."""
    road = road_of(case.net)
    record = record_for(case, road, lefthand=False, exchanged=False)
    row, fine = judged(record, road), judged(at_half_steps(record), road)
    words = (
        "collision_type",
        "at_fault",
        "target_breaches",
        "other_breaches",
        "valid_failure",
        "preventable",
    )
    words += ("offences", "approach", "target_manoeuvre", "collision_partner", "min_ttc_partner")
    assert {x: fine[x] for x in words} == {x: row[x] for x in words}
    assert fine["collision_time_s"] == pytest.approx(row["collision_time_s"], abs=1e-3)
    assert fine["closing_speed_mps"] == pytest.approx(row["closing_speed_mps"], abs=1e-3)
