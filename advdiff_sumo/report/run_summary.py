"""What a run came to, in a few figures."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any, TypeAlias

from advdiff_sumo.metrics.severity import broke_rule, is_valid_failure
from advdiff_sumo.metrics.statistics import wilson
from advdiff_sumo.report.attack_words import out_of_position, plan_lines, position_lines

Rows: TypeAlias = Sequence[dict[str, Any]]


def summary_lines(rows: Rows, timing: Rows) -> list[tuple[str, str]]:
    """Return (name, value with unit) of each line of the table at the end of a run.

    Args:
        rows: of ``episodes.parquet``.
        timing: of ``timing.parquet``.
    """
    finished = [row for row in rows if row["end"] != "failed"]
    ended = {row.get("episode") for row in finished}
    timing = [row for row in timing if row.get("episode") in ended]
    hits = [row for row in finished if row["target_collision"]]
    lines = [
        ("valid failures", _rate(_valid_failures(finished), len(finished))),
        ("critical near misses", _rate(sum(bool(row["critical"]) for row in finished), len(finished))),
        ("target breaks a rule", _rate(sum(map(broke_rule, finished)), len(finished))),
        ("target collides", _rate(len(hits), len(finished))),
        ("… target at fault", _rate(sum(row["at_fault"] == "target" for row in hits), len(finished))),
        ("route completed", _rate(sum(bool(row["route_completed"]) for row in finished), len(finished))),
        ("failed episodes", _rate(len(rows) - len(finished), len(rows))),
        ("median of minimum TTC", _median(finished, "min_ttc_s", "s")),
        ("median of minimum clearance", _median(finished, "min_clearance_m", "m")),
        *position_lines(finished),
        *plan_lines(rows),
        ("real-time factor (median)", _median(timing, "real_time_factor", "×")),
    ]
    for who in ("target", "background"):
        if any(row[f"{who}_plan_p50_s"] is not None for row in timing):
            p50, p99 = (_median(timing, f"{who}_plan_p{share}_s", "s", "{:.4f}") for share in (50, 99))
            lines.append((f"{who}'s plan, median and 99 %", f"{p50}, {p99}"))
    return lines


def summary_figures(rows: Rows) -> dict[str, Any]:
    """Return the counts that the rates in :func:`summary_lines` are of, and failed episodes by kind."""
    finished = [row for row in rows if row["end"] != "failed"]
    hits = [row for row in finished if row["target_collision"]]
    kinds = sorted({str(row["failure_kind"]) for row in rows if row["end"] == "failed"})
    return {
        "episodes": len(rows),
        "finished": len(finished),
        "valid_failures": _valid_failures(finished),
        "critical": sum(bool(row["critical"]) for row in finished),
        "offences": sum(map(broke_rule, finished)),
        "collisions": len(hits),
        "at_fault": sum(row["at_fault"] == "target" for row in hits),
        "routes_completed": sum(bool(row["route_completed"]) for row in finished),
        "out_of_position": sum(out_of_position(row) is not None for row in finished),
        "failed": {kind: sum(row["failure_kind"] == kind for row in rows) for kind in kinds},
        "median_min_ttc_s": _middle(finished, "min_ttc_s"),
        "median_min_clearance_m": _middle(finished, "min_clearance_m"),
    }


def _valid_failures(finished: Rows) -> int:
    return sum(is_valid_failure(row) for row in finished)


def _rate(count: int, total: int) -> str:
    if not total:
        return "no episodes"
    low, high = wilson(count, total)
    return f"{100 * count / total:.1f} %  [{100 * low:.1f}, {100 * high:.1f}]  {count} of {total}"


def _median(rows: Rows, column: str, unit: str, form: str = "{:.2f}") -> str:
    value, known = _middle(rows, column), sum(row[column] is not None for row in rows)
    some = f" (of {known} of {len(rows)} episodes)" if known < len(rows) else ""
    return "–" if value is None else f"{form.format(value)} {unit}{some}"


def _middle(rows: Rows, column: str) -> float | None:
    values = [row[column] for row in rows if row[column] is not None]
    return float(median(values)) if values else None
