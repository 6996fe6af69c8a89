"""Summarises a run in a few figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from typing import Any, TypeAlias

from advdiff_sumo.metrics.severity import Row, broke_rule, has_outcome, is_failure, is_valid_failure
from advdiff_sumo.metrics.statistics import wilson
from advdiff_sumo.report.attack_words import out_of_position, plan_lines, position_lines

Rows: TypeAlias = Sequence[dict[str, Any]]


def summary_lines(rows: Rows, timing: Rows, situation: str = "any") -> list[tuple[str, str]]:
    """Return (name, value with unit) of each line of the table at the end of a run.

    Episodes without a verdict, as in folders of earlier versions, are left out of the rates that need one.

    Args:
        rows: of ``episodes.parquet``.
        timing: of ``timing.parquet``.
        situation: that of a run's seed scenes.
    """
    counted = [row for row in rows if has_outcome(row)]
    counted_episodes = {row.get("episode") for row in counted}
    timing = [row for row in timing if row.get("episode") in counted_episodes]
    collided = [row for row in counted if row["target_collision"]]
    lines = [
        ("valid failures", _judged_rate(counted, "valid_failure", is_valid_failure)),
        ("critical near misses", _judged_rate(counted, "critical", lambda row: bool(row["critical"]))),
        ("target breaks a rule", _judged_rate(counted, "offences", broke_rule)),
        ("target collides", _rate(len(collided), len(counted))),
        ("… target at fault", _rate(sum(row["at_fault"] == "target" for row in collided), len(counted))),
        ("route completed", _rate(sum(bool(row["route_completed"]) for row in counted), len(counted))),
        ("failed episodes", _rate(sum(map(is_failure, rows)), len(rows))),
        ("median of minimum TTC", _median_text(counted, "min_ttc_s", "s")),
        ("median of minimum clearance", _median_text(counted, "min_clearance_m", "m")),
        *position_lines(counted, situation),
        *plan_lines(rows),
        ("real-time factor (median)", _median_text(timing, "real_time_factor", "×")),
    ]
    for role in ("target", "background"):
        if any(row[f"{role}_plan_p50_s"] is not None for row in timing):
            p50, p99 = (_median_text(timing, f"{role}_plan_p{share}_s", "ms", 1e3) for share in (50, 99))
            lines.append((f"{role}'s plan, median and 99 %", f"{p50}, {p99}"))
    return lines


def summary_figures(rows: Rows) -> dict[str, Any]:
    """Return the counts behind the rates of :func:`summary_lines`, and failed episodes by kind.

    Episodes that failed after a collision of the target count in all of these, but not as finished.
    """
    counted = [row for row in rows if has_outcome(row)]
    collided = [row for row in counted if row["target_collision"]]
    kinds = sorted({str(row["failure_kind"]) for row in rows if is_failure(row)})
    return {
        "episodes": len(rows),
        "finished": sum(not is_failure(row) for row in rows),
        "valid_failures": _valid_failures(counted),
        "critical": sum(bool(row["critical"]) for row in counted),
        "offences": sum(map(broke_rule, counted)),
        "collisions": len(collided),
        "at_fault": sum(row["at_fault"] == "target" for row in collided),
        "routes_completed": sum(bool(row["route_completed"]) for row in counted),
        "out_of_position": sum(out_of_position(row) is not None for row in counted),
        "failed": {kind: sum(row["failure_kind"] == kind for row in rows) for kind in kinds},
        "median_min_ttc_s": _median_value(counted, "min_ttc_s"),
        "median_min_clearance_m": _median_value(counted, "min_clearance_m"),
    }


def _valid_failures(counted: Rows) -> int:
    return sum(is_valid_failure(row) for row in counted)


def _judged_rate(counted: Rows, column: str, happened: Callable[[Row], bool]) -> str:
    """Return the rate of an event among the *counted* episodes in which *column* says whether it happened."""
    judged = [row for row in counted if row.get(column) is not None]
    return "not judged" if counted and not judged else _rate(sum(map(happened, judged)), len(judged))


def _rate(count: int, total: int) -> str:
    if not total:
        return "no episodes"
    low, high = wilson(count, total)
    return f"{100 * count / total:.1f} %  [{100 * low:.1f}, {100 * high:.1f}]  {count} of {total}"


def _median_text(rows: Rows, column: str, unit: str, units_per_value: float = 1.0) -> str:
    value, known_count = _median_value(rows, column), sum(row[column] is not None for row in rows)
    note = f" (of {known_count} of {len(rows)} episodes)" if known_count < len(rows) else ""
    return "–" if value is None else f"{units_per_value * value:.2f} {unit}{note}"


def _median_value(rows: Rows, column: str) -> float | None:
    values = [row[column] for row in rows if row[column] is not None]
    return float(median(values)) if values else None
