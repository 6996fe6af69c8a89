"""Reference drivers on hand-made records on the crossing of ``tests/metrics/conftest.py``."""

from __future__ import annotations

import math

import numpy as np
import pytest

from advdiff_sumo.core.errors import UnknownNameError
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.reference import MODELS, drive_all, drive_reference

NORTH = math.pi / 2


def drives(record, road, **options):
    """Return what each reference driver does about the target's first collision."""
    hit = target_collision(record, collisions(record))
    assert hit is not None, "the record was meant to hold a collision"
    return drive_all(record, road, hit, **options)


def test_the_human_driver_stops_before_a_standing_car(straight, record_of, road) -> None:
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)
    still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
    drive = drives(record_of(ego, still), road)["CC_human_driver"]
    # 125.5 m bumper to bumper; contact in step 83; at step 33 it is 5.07 s away, at step 34 4.97 s: perceived.
    assert drive.takeover_step == 33
    # 8 steps at 0.4 m/s²: 11.856 m; 6 steps of growing braking: 8.100 m; 15 steps at 7.593 m/s²: 8.924 m
    assert drive.spare_m == pytest.approx(125.5 - 34 * 1.5 - 28.880, abs=0.01)
    assert drive.contact_step is None
    assert drive.contact_with is None
    assert drive.impact_mps == 0.0
    assert drive.states.speed_mps[-1] == 0.0
    np.testing.assert_allclose(drive.states.xy_m[:, 1], -4.8, atol=0.05)


def test_a_cut_in_of_a_third_of_a_second_is_beyond_everybody_but_the_far_sighted(
    straight, record_of, road
) -> None:
    ego = straight("ego", (-150, -4.8), 0, 15)
    cutter = straight("cutter", (-142.5, -1.6), 0, 5, drift=-4.0)
    # from 1.2 m apart sideways to contact in 0.3 s; 3.5 m ahead, closing in at 10 m/s
    result = drives(record_of(ego, cutter), road)
    for name in ("CC_human_driver", "Reg157"):
        assert result[name].contact_with == "cutter"
        assert result[name].spare_m == 0.0
        assert result[name].spare_s == 0.0
        assert result[name].impact_mps > 0.0


def test_who_stands_is_hit_all_the_same(straight, record_of, road) -> None:
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


def test_a_late_look_back_takes_over_later(straight, record_of, road) -> None:
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)
    still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
    record = record_of(ego, still)
    takeovers = [drives(record, road, lookback_s=s)["CC_human_driver"].takeover_step for s in (5, 3, 2)]
    assert takeovers == [33, 53, 63]
    assert drives(record, road, lookback_s=2)["CC_human_driver"].contact_step is None
    assert drives(record, road, lookback_s=1)["CC_human_driver"].contact_step is not None


def test_a_drive_that_avoids_one_and_hits_another_counts_as_contact(straight, record_of, road) -> None:
    ego = straight("ego", (-190, -4.8), 0, 15, steps=90)
    still = straight("still", (-60.5, -4.8), 0, 0, steps=90)
    behind = straight("behind", (-200, -4.8), 0, 14.9, steps=90)
    drive = drives(record_of(ego, still, behind), road)["CC_human_driver"]
    assert drive.contact_with == "behind"
    assert drive.spare_m == 0.0


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
