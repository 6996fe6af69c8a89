"""Reference drivers on hand-made records on the crossing of ``tests/metrics/conftest.py``."""

from __future__ import annotations

import gzip
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import UnknownNameError
from advdiff_sumo.core.polylines import concatenate
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.reference import MODELS, drive_all, drive_reference
from advdiff_sumo.metrics.reference.reference_drive import ReferenceDrivers

NORTH = math.pi / 2


def drives(record, road, **options):
    """Return the drive of each reference driver in the target's first collision."""
    hit = target_collision(record, collisions(record))
    assert hit is not None, "the record was meant to hold a collision"
    return drive_all(record, road, hit, **options)


def test_the_human_driver_stops_before_a_standing_car(straight, record_of, road) -> None:
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)
    still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
    drive = drives(record_of(ego, still), road)["CC_human_driver"]
    # 125.5 m bumper to bumper; contact in step 83; at step 33 it is 5.07 s away, at step 34 4.97 s: perceived.
    assert drive.takeover_step == 33
    # 8 steps at 0.4 m/s²: 11.856 m; 6 steps of growing braking: 8.020 m; 15 steps at 7.593 m/s²: 8.623 m
    assert drive.spare_m == pytest.approx(125.5 - 34 * 1.5 - 28.499, abs=0.002)
    assert drive.contact_step is None
    assert drive.contact_with is None
    assert drive.impact_mps == 0.0
    assert drive.states.speed_mps[-1] == 0.0
    np.testing.assert_allclose(drive.states.xy_m[:, 1], -4.8, atol=0.05)


def test_only_the_far_sighted_models_avoid_a_cut_in_of_a_third_of_a_second(straight, record_of, road) -> None:
    ego = straight("ego", (-150, -4.8), 0, 15)
    cutter = straight("cutter", (-142.5, -1.6), 0, 5, drift=-4.0)
    # from 1.2 m apart sideways to contact in 0.3 s; 3.5 m ahead, closing in at 10 m/s
    result = drives(record_of(ego, cutter), road)
    for name in ("CC_human_driver", "Reg157"):
        assert result[name].contact_with == "cutter"
        assert result[name].spare_m == 0.0
        assert result[name].spare_s == 0.0
        assert result[name].impact_mps > 0.0


def test_off_its_route_each_driver_follows_the_way_from_its_own_takeover(straight, record_of, road) -> None:
    """Also if it takes over as many instants after the earliest takeover as that is after the record's begin."""
    ego = straight("ego", (-190, -4.8), 0, 15, drift=0.4, steps=90)
    record = record_of(ego, straight("still", (-60.5, -1.6), 0, 0, steps=90))
    hit = target_collision(record, collisions(record))
    assert hit is not None
    begin = hit.step - 50
    drivers = ReferenceDrivers(record, road, hit)
    for start in (0, begin, begin + 1):
        line = drivers._way_from_takeover(start).line
        along_m, _ = line.project(record.tracks.xy_m[record.target, begin + start])
        assert along_m == pytest.approx(20.0, abs=0.2)  # the way begins 20 m behind the driver


def test_a_standing_driver_is_hit_as_well(straight, record_of, road) -> None:
    ego = straight("ego", (-60, -4.8), 0, 0)
    other = straight("other", (-100, -4.8), 0, 15)
    for drive in drives(record_of(ego, other), road).values():
        assert drive.contact_with == "other"
        assert drive.impact_mps == pytest.approx(15.0)


def test_a_crossing_car_is_seen_in_time(straight, record_of, road) -> None:
    ego = straight("ego", (-42, -1.6), 0, 10, steps=60)
    crosser = straight("crosser", (1.6, -44), NORTH, 10, steps=60)
    # both are 40 m from the meeting point; the human driver brakes from 2 s before it: 20 m, of which it needs 16 m
    drive = drives(record_of(ego, crosser), road)["CC_human_driver"]
    assert drive.contact_step is None
    assert 0.0 < drive.spare_m < 6.0
    assert 0.0 < drive.spare_s <= 2.0


def test_a_red_light_binds(straight, record_of, light_road) -> None:
    link = next(x for x in light_road.links.values() if x.from_lane == "WC_1" and x.direction == "s")
    length = 1 + max(x.tls_index for x in light_road.links.values() if x.tls_index is not None)
    red = "".join("r" if i == link.tls_index else "G" for i in range(length))
    ego = straight("ego", (-102, -1.6), 0, 14, steps=90)
    crosser = straight("crosser", (1.6, -88), NORTH, 12, steps=90)
    record = record_of(ego, crosser, signals=({link.tls_id: red},) * 90)
    line = light_road.lanes["WC_1"].centre_xy_m[-1, 0]
    for drive in drives(record, light_road).values():
        assert drive.contact_step is None
        assert drive.states.xy_m[-1, 0] + 2.0 <= line
    green = record_of(ego, crosser, signals=({link.tls_id: "G" * length},) * 90)
    assert drives(green, light_road)["CC_human_driver"].states.xy_m[-1, 0] + 2.0 > line


def test_the_duty_to_yield_binds(straight, record_of, road) -> None:
    ego = straight("ego", (1.6, -62), NORTH, 10, steps=70)
    crosser = straight("crosser", (-72, -1.6), 0, 12, steps=70)
    record = record_of(ego, crosser, route=("SC", "CN"))
    line = road.lanes["SC_0"].centre_xy_m[-1, 1]
    hit = target_collision(record, collisions(record))
    for name in MODELS:
        drive = drive_reference(record, road, hit, name)
        assert drive.contact_step is None, name
        before = drive.states.xy_m[:, 1] + 2.0 <= line
        assert before[0], name
        assert drive.accel_mps2[before].min() <= -2.0, name  # it slows down at the line, not in the junction


def test_a_vehicle_that_appears_late_is_perceived_late(straight, record_of, road) -> None:
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)
    still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
    gone = straight("gone", (-100, -1.6), 0, 10, steps=90)
    still.xy_m[:75] = np.nan
    gone.xy_m[40:] = np.nan
    drive = drives(record_of(ego, still, gone), road)["CC_human_driver"]
    # there from 7.5 s on, 13 m ahead; the contact is at 8.4 s: off the pedal for 0.75 s, hardly braking
    assert drive.takeover_step == 74
    assert drive.contact_with == "still"
    assert drive.impact_mps > 13.0


def test_a_shorter_look_back_takes_over_later(straight, record_of, road) -> None:
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)
    still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
    record = record_of(ego, still)
    takeovers = [drives(record, road, lookback_s=s)["CC_human_driver"].takeover_step for s in (5, 3, 2)]
    assert takeovers == [33, 53, 63]
    assert drives(record, road, lookback_s=2)["CC_human_driver"].contact_step is None
    assert drives(record, road, lookback_s=1)["CC_human_driver"].contact_step is not None


def test_the_takeover_needs_a_safe_stretch_unless_it_is_at_the_first_instant(
    straight, road, record_of
) -> None:
    """The vehicle hit at 8.3 s is visible except for some instants; two of them, from 7.4 s on, are less than 0.3 s."""
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)

    def takeover(*unseen: int) -> int:
        still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
        still.xy_m[list(unseen)] = np.nan
        return drives(record_of(ego, still), road, lookback_s=1)["CC_human_driver"].takeover_step

    assert takeover() == 73
    assert takeover(74) == takeover(74, 75) == takeover(75, 76) == 73
    assert takeover(73) == 73
    assert takeover(73, 74) == 74
    assert takeover(74, 75, 76) == 76


def test_avoiding_one_vehicle_but_hitting_another_counts_as_contact(straight, record_of, road) -> None:
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)
    still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
    behind = straight("behind", (-200, -4.8), 0, 14.9, steps=90)
    drive = drives(record_of(ego, still, behind), road)["CC_human_driver"]
    assert drive.contact_with == "behind"
    assert drive.spare_m == pytest.approx(
        125.5 - 34 * 1.5 - 28.499, abs=0.002
    )  # to "still", as without "behind"


def test_same_record_same_drive(straight, record_of, road) -> None:
    ego = straight("ego", (-42, -1.6), 0, 10, steps=60)
    crosser = straight("crosser", (1.6, -44), NORTH, 10, steps=60)
    record = record_of(ego, crosser)
    hit = target_collision(record, collisions(record))
    together = drive_all(record, road, hit)
    for name in MODELS:
        alone = drive_reference(record, road, hit, name)
        np.testing.assert_array_equal(alone.states.xy_m, together[name].states.xy_m)
        assert (alone.takeover_step, alone.contact_step) == (
            together[name].takeover_step,
            together[name].contact_step,
        )


def test_an_unknown_model_is_named(straight, record_of, road) -> None:
    ego = straight("ego", (-60, -4.8), 0, 0)
    other = straight("other", (-100, -4.8), 0, 15)
    record = record_of(ego, other)
    with pytest.raises(UnknownNameError, match="reference driver 'human'"):
        drive_reference(record, road, target_collision(record, collisions(record)), "human")


@pytest.mark.data
def test_on_a_straight_lane_it_agrees_with_the_models(adv_data: Path, straight, road, record_of) -> None:
    cells = [cell for cell in _critical_cells(adv_data / "r157" / "cut_in_low.csv.gz") if cell[3] > 0.25]
    picked = [cells[i] for i in np.random.default_rng(3).permutation(len(cells))]
    differ, looked_at = [], 0
    for ego, other, gap, lateral, crashes in picked:
        record = record_of(*_cut_in(straight, ego, other, gap, lateral))
        hit = target_collision(record, collisions(record))
        if hit is None:
            continue
        looked_at += 1
        drawn = drive_all(replace(record, tracks=record.tracks.window(0, hit.step + 2)), road, hit)
        for name, drive in drawn.items():
            if (drive.contact_step is not None) != crashes[name]:
                assert not crashes[name], (name, ego, other, gap, lateral)
                differ.append((name, ego, other, gap, lateral))
        if looked_at == 40:
            break
    assert looked_at == 40
    # corners that meet between two instants of 0.1 s: the swept boxes touch, those of the instants do not
    assert len(differ) <= 5, differ


def _critical_cells(path: Path) -> list[tuple[float, float, float, float, dict[str, bool]]]:
    """Return the cells of the grid: speeds in m/s, gap, lateral speed, and which models collide."""
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    names = lines[0].split(",")
    rows = [dict(zip(names, line.split(","), strict=True)) for line in lines[1:]]
    return [
        (
            float(row["ego_kmh"]) / 3.6,
            float(row["other_kmh"]) / 3.6,
            float(row["gap_m"]),
            float(row["lateral_mps"]),
            {name: row[name] == "1" for name in MODELS},
        )
        for row in rows
        if float(row["lateral_mps"]) > 0.0
    ]


def _cut_in(straight, ego: float, other: float, gap: float, lateral: float):
    """Return both cars of a cut-in, along the street, so that the meeting lies before its end."""
    ramp = int(np.ceil(lateral / 0.15 - 1e-9))
    steady = int(np.floor(35 / lateral)) + 1
    instants = np.arange(-ramp - 20, min(steady + 5, 90))
    sideways = np.where(
        instants < 0, np.clip(0.15 * (ramp + instants), 0, lateral), np.where(instants < steady, lateral, 0.0)
    )
    offset = (
        3.5 + 0.1 * sideways[instants < 0].sum() - 0.1 * np.concatenate(([0.0], np.cumsum(sideways)[:-1]))
    )
    count, time = len(instants), 0.1 * instants
    start = -190.0 + 0.1 * ego * (ramp + 20)
    begin = start + gap + 4.3 + other * time[0]
    own = straight("ego", (-190.0, -4.8), 0.0, ego, steps=count, size=(4.3, 1.9))
    theirs = straight("other", (begin, -4.8), 0.0, other, steps=count, size=(4.3, 1.9))
    return own, replace(theirs, xy_m=theirs.xy_m + np.stack((np.zeros(count), offset), -1))


def test_without_a_route_the_way_is_where_the_target_drove(straight, record_of, road) -> None:
    """The target turns left onto the north arm, where a car stands just beyond the junction."""
    link = road.links["WC_1", "CN_0"]
    line = concatenate([road.lanes[x].line for x in ("WC_1", *link.via, "CN_0")])
    stop = road.lanes["WC_1"].length_m
    begin, still = (float(x) for x in (stop - 35.0, stop + 14.0))
    xy, yaw = line.at(begin + 0.8 * np.arange(81))
    turning = replace(straight("ego", (0.0, 0.0), 0.0, 8.0, steps=81), xy_m=xy, yaw_rad=yaw)
    place, along = line.at(np.full(81, still))
    lead = replace(straight("lead", (0.0, 0.0), 0.0, 0.0, steps=81), xy_m=place, yaw_rad=along)
    known, unknown = (drives(record_of(turning, lead, route=r), road) for r in (("WC", "CN"), ()))
    assert known.keys() == unknown.keys()
    assert known["CC_human_driver"].contact_step is None
    for name, drive in known.items():
        assert unknown[name].contact_step == drive.contact_step, name
        np.testing.assert_allclose(unknown[name].states.xy_m, drive.states.xy_m, atol=0.3)


def test_a_jump_is_no_contact(straight, record_of, road) -> None:
    """A vehicle with a known id appears 120 m away within one step, across the way of both."""
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)
    still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
    jumper = straight("jumper", (-120, 60), 0, 0, steps=90)
    xy = jumper.xy_m.copy()
    xy[60:, 1] = -60.0
    result = drives(record_of(ego, still, replace(jumper, xy_m=xy)), road)
    assert {name: drive.contact_with for name, drive in result.items()} == dict.fromkeys(result)
