"""Rows match their columns, progress is measured, and no value is NaN."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from advdiff_sumo.core.record import EndReason, Failure
from advdiff_sumo.metrics.arrow_tables import schema_of, upgraded_table
from advdiff_sumo.metrics.columns import COLLISION_COLUMNS, EPISODE_COLUMNS, LATER_COLUMNS, Column
from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row
from advdiff_sumo.metrics.progress import progress
from advdiff_sumo.metrics.summary import summarise

TYPES = {"str": str, "int64": int, "float64": float, "bool": bool}


def fits(row: dict[str, object], columns: dict[str, Column]) -> None:
    """Assert that *row* has the keys, types and nulls that *columns* state."""
    assert list(row) == list(columns)
    for name, value in row.items():
        column = columns[name]
        if value is None:
            assert column.nullable, name
            continue
        assert type(value) is TYPES[column.dtype], name
        assert not (isinstance(value, float) and not math.isfinite(value)), name


def test_rows_of_a_collision(straight, record_of, road) -> None:
    record = record_of(
        straight("ego", (-100, -1.6), 0, 15),
        straight("lead", (-80, -1.6), 0, 10),
        straight("b", (-100, 1.6), math.pi, 0),
        straight("c", (-98, 1.6), math.pi, 0),
    )
    row = episode_row(record, road)
    fits(row, EPISODE_COLUMNS)
    assert row["target_collision"] is True
    assert (row["collision_partner"], row["collision_type"], row["at_fault"]) == (
        "lead",
        "rear_end_striking",
        "target",
    )
    assert row["collision_time_s"] == pytest.approx(3.2)
    assert (row["impact_x_m"], row["impact_y_m"]) == (pytest.approx(-50.0), pytest.approx(-1.6))
    assert (row["impact_ahead_m"], row["impact_left_m"]) == (pytest.approx(2.0), pytest.approx(0.0, abs=1e-9))
    assert (row["target_speed_mps"], row["partner_speed_mps"]) == (pytest.approx(15.0), pytest.approx(10.0))
    assert row["min_clearance_m"] == 0.0
    assert row["min_ttc_s"] == pytest.approx(0.0, abs=0.11)
    assert (row["initial_overlaps"], row["bv_collisions"]) == (1, 0)
    rows = collision_rows(record, road)
    for entry in rows:
        fits(entry, COLLISION_COLUMNS)
    assert [(r["first"], r["second"], r["initial"], r["type"]) for r in rows] == [
        ("b", "c", True, None),
        ("ego", "lead", False, "rear_end_striking"),
    ]


def test_counts_of_the_simulation_are_passed_on(straight, record_of, road) -> None:
    record = replace(record_of(straight("ego", (-150, -1.6), 0, 10)), rough_handovers=2, skipped_agents=3)
    row = episode_row(replace(record, safeguarded=(4, 90), implausible=(2, "it steers")), road)
    assert (row["implausible_plans"], row["implausible_plan"]) == (2, "it steers")
    assert (row["rough_handovers"], row["skipped_agents"]) == (2, 3)
    assert (row["safeguarded_plans"], row["moved_plans"]) == (4, 90)


def test_rows_of_an_empty_road_of_leaving_it_and_of_a_failure(straight, record_of, road) -> None:
    calm = record_of(straight("ego", (-150, -1.6), 0, 10))
    row = episode_row(calm, road)
    fits(row, EPISODE_COLUMNS)
    assert row["target_collision"] is False
    assert {row[k] for k in ("min_ttc_s", "min_pet_s", "max_drac_mps2", "min_clearance_m", "at_fault")} == {
        None
    }
    leaving = record_of(straight("ego", (-150, -4.8), 0, 10, drift=-1.0))
    row = episode_row(leaving, road)
    fits(row, EPISODE_COLUMNS)
    assert (row["collision_type"], row["collision_partner"], row["at_fault"]) == ("off_road", None, "target")
    (entry,) = collision_rows(leaving, road)
    fits(entry, COLLISION_COLUMNS)
    failure = Failure("plan_refused", "The plan holds NaN.", 0.0)
    failed = replace(
        record_of(straight("ego", (-150, -1.6), 0, 10, steps=1)), end=EndReason.FAILED, failure=failure
    )
    row = episode_row(failed, road)
    fits(row, EPISODE_COLUMNS)
    assert (row["end"], row["failure_kind"]) == ("failed", "plan_refused")
    assert row["duration_s"] == 0.0


def test_progress_along_the_route(straight, record_of, road) -> None:
    record = record_of(straight("ego", (-150, -1.6), 0, 30, steps=81), route=("WC", "CE"))
    done = progress(record, road)
    assert done.route_m == pytest.approx(240.0, abs=0.2)
    assert done.route_share == pytest.approx(240.0 / 350.0, abs=0.002)
    assert done.distance_m == pytest.approx(240.0)
    assert not done.completed
    assert (done.speed_mean_mps, done.speed_max_mps) == (30.0, 30.0)
    arrived = progress(replace(record, end=EndReason.ARRIVED), road)
    assert (arrived.completed, arrived.route_share) == (True, 1.0)
    assert progress(replace(record, route=()), road).route_m is None
    assert progress(replace(record, route=("gone",)), road).route_share is None


def test_comfort_and_criticality_end_at_the_collision(straight, record_of, road) -> None:
    ego = straight("ego", (-100, -1.6), 0, 15)
    ego.speed_mps[33:] = 0.0  # contact at 3.2 s stops it
    metrics = summarise(record_of(ego, straight("lead", (-80, -1.6), 0, 10)), road)
    assert metrics.comfort.accel_max_mps2 == pytest.approx(0.0, abs=1e-9)
    assert metrics.criticality.drac_mps2 is not None
    # the last instant before the contact is 3.1 s: 0.5 m at 5 m/s
    assert metrics.criticality.drac_mps2 == pytest.approx(25.0, rel=1e-3)


def test_all_columns_have_descriptions_and_units() -> None:
    for name, column in {**EPISODE_COLUMNS, **COLLISION_COLUMNS}.items():
        assert column.dtype in TYPES
        assert column.description
        for suffix, unit in (
            ("_m", "m"),
            ("_s", "s"),
            ("_mps", "m/s"),
            ("_mps2", "m/s²"),
            ("_radps", "rad/s"),
        ):
            if name.endswith(suffix):
                assert column.unit == unit, name


def test_a_target_that_arrives_and_vanishes_leaves_full_rows(straight, record_of, road) -> None:
    ego = straight("ego", (-100, -1.6), 0, 15)
    ego.xy_m[30:] = math.nan
    lead = straight("lead", (-60, -1.6), 0, 10)
    lead.xy_m[:5] = math.nan
    gone = straight("gone", (0, 40), 0, 5)
    gone.xy_m[:] = math.nan
    record = replace(record_of(ego, lead, gone), end=EndReason.ARRIVED)
    row = episode_row(record, road)
    fits(row, EPISODE_COLUMNS)
    assert (row["agents"], row["route_completed"], row["target_collision"]) == (2, True, False)
    # 38 - 0.5 t at 5 m/s: 36 m at instant 0; last seen at 2.9 s: 36 - 14.5 = 21.5 m
    assert row["min_clearance_m"] == pytest.approx(21.5)
    assert row["min_lane_ttc_s"] == pytest.approx(4.3)


def test_metrics_do_not_change_when_other_rows_are_reordered(straight, record_of, road) -> None:
    ego = straight("ego", (-100, -1.6), 0, 15)
    lead, other = straight("lead", (-80, -1.6), 0, 10), straight("other", (-90, -4.8), 0, 12)
    rows = [episode_row(record_of(ego, *rest), road) for rest in ((lead, other), (other, lead))]
    for name in EPISODE_COLUMNS:
        expected = rows[1][name]
        assert rows[0][name] == (pytest.approx(expected) if isinstance(expected, float) else expected), name


@pytest.mark.parametrize("columns", [EPISODE_COLUMNS, COLLISION_COLUMNS])
def test_columns_missing_in_earlier_versions_are_unknown(columns: dict[str, Column]) -> None:
    unknown = {name for name, column in columns.items() if "earlier versions" in column.description}
    assert unknown <= LATER_COLUMNS
    whole = schema_of(columns).empty_table()
    earlier = whole.drop_columns([name for name in columns if name in LATER_COLUMNS])
    assert set(upgraded_table(earlier, columns).column_names) == set(columns)
