"""Adapts proposed manoeuvres to a prescribed severity, and rates how near each comes to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.traffic.licence import LAWFUL
from advdiff_sumo.traffic.manoeuvres.intensity import BRAKING_KINDS, Intensity
from advdiff_sumo.traffic.manoeuvres.licence_rules import entry_margin_m
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.priority_traffic import conflict_points_m
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    MAX_DEMAND_MPS2,
    crossing_links,
    cut_out_at,
    positioning_profile,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.slow_entries import slow_entry_margin_m
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S

AFTER_ENTRY_MPS2 = 6.5
"""Deceleration after a cut-in with a prescribed gap; one of ``repertoire.AFTER_CUT_IN_MPS2``."""
GAP_TOLERANCE_M = 3.0
"""The gap of a cut-in may exceed the prescribed one by this much."""
_MATCH_LOSS_PER_S = 0.5  # loss of the match per second off the prescribed time
_BRAKES_MPS2 = 1.0  # a target that slows by more than this brakes


def with_severity(
    view: SituationView, proposals: Sequence[Manoeuvre], intensity: Intensity
) -> Iterator[Manoeuvre]:
    """Yield those of *proposals* that can have the prescribed severity, lane changes adapted to it."""
    target = view.target
    if intensity.reveals_s is not None:
        cut_out_rows = dict.fromkeys(m.row for m in proposals if m.kind == "cut-out")
        yield from (m for row in cut_out_rows for m in cut_out_at(view, row, (intensity.reveals_s,)))
        proposals = [m for m in proposals if m.kind != "cut-out"]
    for manoeuvre in proposals:
        if manoeuvre.kind != "cut-in" or intensity.spare_gap_m is None or target is None:
            yield manoeuvre
        elif manoeuvre.is_positioning:
            profile = positioning_profile(view, target, manoeuvre.row, intensity.spare_gap_m)
            yield replace(manoeuvre, profile=profile)
        elif manoeuvre.profile.then_mps2 == -AFTER_ENTRY_MPS2:
            yield manoeuvre


def severity_match(
    view: SituationView,
    manoeuvre: Manoeuvre,
    driven_m: FloatArray,
    needed_mps2: float,
    intensity: Intensity,
) -> float | None:
    """Return how near *manoeuvre* comes to the prescribed severity, 1 at it and 0 far off; None if none is prescribed.

    Args:
        view: the scene.
        manoeuvre: driven from now on.
        driven_m: (T,) distances along its way at ``CHECK_TIMES_S``.
        needed_mps2: the required deceleration of the target.
        intensity: the prescribed severities.
    """
    if manoeuvre.is_positioning or not intensity.is_prescribed_for(manoeuvre.kind):
        return None
    if manoeuvre.kind == "cut-out":
        return 1.0
    if intensity.spare_gap_m is not None and manoeuvre.kind in MAX_DEMAND_MPS2:
        is_resolvable = needed_mps2 <= MAX_DEMAND_MPS2[manoeuvre.kind]
        return float(is_resolvable and slow_entry_margin_m(view, manoeuvre, LAWFUL) >= intensity.spare_gap_m)
    if intensity.spare_gap_m is not None and manoeuvre.kind == "cut-in":
        enters_s = manoeuvre.enters_s(view.scene.history.xy_m[manoeuvre.row, -1])
        spare_m = entry_margin_m(view, manoeuvre.row, view.scene.target, enters_s, LAWFUL)
        return float(0.0 <= spare_m - intensity.spare_gap_m <= GAP_TOLERANCE_M)
    early_s = arrival_lead_s(view, manoeuvre.row, driven_m)
    error_s = np.inf if early_s is None or intensity.early_s is None else abs(early_s - intensity.early_s)
    return max(0.0, 1.0 - _MATCH_LOSS_PER_S * float(error_s))


def arrival_lead_s(view: SituationView, row: int, driven_m: FloatArray) -> float | None:
    """Return how long before a target that does not respond *row* is where their ways meet at a junction.

    None if their ways do not meet, or one of them is not there within 6 s.

    Args:
        view: the scene.
        row: row of the other vehicle.
        driven_m: (T,) distances that it drives up to ``CHECK_TIMES_S``.
    """
    links, target = crossing_links(view, row), view.target
    points = None if links is None else conflict_points_m(view.road, links[1], links[0])
    if links is None or points is None or target is None:
        return None
    own_link, target_link = links
    own_m = next((line_m + points[1] for line_m, link in view.ways[row].links if link is own_link), None)
    target_m = next((line_m + points[0] for line_m, link in target.way.links if link is target_link), None)
    if own_m is None or target_m is None or own_m > driven_m[-1]:
        return None
    arrives_s = float(np.interp(own_m, np.append(0.0, driven_m), np.append(0.0, CHECK_TIMES_S)))
    lead_s = target.arrival_s(target_m) - arrives_s
    return lead_s if np.isfinite(lead_s) else None


def with_braking(manoeuvre: Manoeuvre, braking_mps2: float | None) -> Manoeuvre:
    """Return *manoeuvre* with this deceleration if it attacks by braking; None: leave it unchanged."""
    if braking_mps2 is None or manoeuvre.is_positioning or manoeuvre.kind not in BRAKING_KINDS:
        return manoeuvre
    profile = manoeuvre.profile
    first, then = (-braking_mps2 if a < 0.0 else a for a in (profile.first_mps2, profile.then_mps2))
    return replace(manoeuvre, profile=replace(profile, first_mps2=first, then_mps2=then))


def target_brakes(view: SituationView, over_mps2: float = _BRAKES_MPS2) -> bool:
    """Return whether the target has slowed by more than *over_mps2*, 1 m/s² by default, in the last step."""
    return -view.accel_mps2(view.scene.target) > over_mps2
