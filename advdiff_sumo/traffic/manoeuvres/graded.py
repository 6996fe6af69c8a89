"""Manoeuvres of an asked severity: proposals brought to it, and how near each comes."""

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
from advdiff_sumo.traffic.manoeuvres.repertoire import DOUBLE, crossing_links, cut_out_at, positioning_profile
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.speed_profiles import CHECK_TIMES_S

AFTER_ENTRY_MPS2 = 6.5
"""How somebody slows who has cut in with an asked gap; one of ``repertoire.AFTER_CUT_IN_MPS2``."""
GAP_TOLERANCE_M = 3.0
"""Somebody cuts in with up to so much more than the asked gap."""
_WORTH_PER_S = 0.5
_BRAKES_MPS2 = 1.0


def with_severity(
    view: SituationView, proposals: Sequence[Manoeuvre], intensity: Intensity
) -> Iterator[Manoeuvre]:
    """Yield those of *proposals* that can have the asked severity, brought to it before a change of lanes."""
    target = view.target
    if intensity.reveals_s is not None:
        leave = dict.fromkeys(m.row for m in proposals if m.kind == "cut-out")
        yield from (m for row in leave for m in cut_out_at(view, row, (intensity.reveals_s,)))
        proposals = [m for m in proposals if m.kind != "cut-out"]
    for manoeuvre in proposals:
        if manoeuvre.kind != "cut-in" or intensity.spare_gap_m is None or target is None:
            yield manoeuvre
        elif manoeuvre.sets_up:
            profile = positioning_profile(view, target, manoeuvre.row, intensity.spare_gap_m)
            yield replace(manoeuvre, profile=profile)
        elif manoeuvre.profile.then_mps2 == -AFTER_ENTRY_MPS2:
            yield manoeuvre


def severity_match(
    view: SituationView, manoeuvre: Manoeuvre, driven_m: FloatArray, intensity: Intensity
) -> float | None:
    """Return how near *manoeuvre* comes to the asked severity, 1 at it and 0 far off; None where none is asked.

    Args:
        view: the scene.
        manoeuvre: driven from now on.
        driven_m: (T,) distances along its way at ``CHECK_TIMES_S``.
        intensity: what is asked for.
    """
    if manoeuvre.sets_up or not intensity.is_prescribed_for(manoeuvre.kind):
        return None
    if manoeuvre.kind == "cut-out":
        return 1.0
    if intensity.spare_gap_m is not None and manoeuvre.kind == "cut-in":
        enters_s = manoeuvre.enters_s(view.scene.history.xy_m[manoeuvre.row, -1])
        more = (
            entry_margin_m(view, manoeuvre.row, view.scene.target, enters_s, LAWFUL) - intensity.spare_gap_m
        )
        return float(0.0 <= more <= GAP_TOLERANCE_M)
    early = arrival_lead_s(view, manoeuvre.row, driven_m)
    off = np.inf if early is None or intensity.early_s is None else abs(early - intensity.early_s)
    return max(0.0, 1.0 - _WORTH_PER_S * float(off))


def arrival_lead_s(view: SituationView, row: int, driven_m: FloatArray) -> float | None:
    """Return how long before a target that goes on *row* is where their ways meet at a junction.

    None where they do not meet, or one of them is not there within 6 s.

    Args:
        view: the scene.
        row: of the other vehicle.
        driven_m: (T,) distances that it drives up to ``CHECK_TIMES_S``.
    """
    links, target = crossing_links(view, row), view.target
    places = None if links is None else conflict_points_m(view.road, links[1], links[0])
    if links is None or places is None or target is None:
        return None
    own, targets = links
    theirs = next((reach + places[1] for reach, link in view.ways[row].links if link is own), None)
    ahead = next((reach + places[0] for reach, link in target.way.links if link is targets), None)
    if theirs is None or ahead is None or theirs > driven_m[-1]:
        return None
    arrives_s = float(np.interp(theirs, np.append(0.0, driven_m), np.append(0.0, CHECK_TIMES_S)))
    before_s = target.arrival_s(ahead) - arrives_s
    return before_s if np.isfinite(before_s) else None


def with_braking(manoeuvre: Manoeuvre, braking_mps2: float | None) -> Manoeuvre:
    """Return *manoeuvre* with this braking where it is an attack by braking; None: as it is."""
    if braking_mps2 is None or manoeuvre.sets_up or manoeuvre.kind not in (*BRAKING_KINDS, DOUBLE):
        return manoeuvre
    profile = manoeuvre.profile
    first, then = (-braking_mps2 if a < 0.0 else a for a in (profile.first_mps2, profile.then_mps2))
    return replace(manoeuvre, profile=replace(profile, first_mps2=first, then_mps2=then))


def target_brakes(view: SituationView, over_mps2: float = _BRAKES_MPS2) -> bool:
    """Return whether the target has braked by over *over_mps2*, 1 m/s² if none is given, in the last step."""
    history = view.scene.history
    speed = history.speed_mps[view.scene.target]
    return len(speed) > 1 and bool((speed[-2] - speed[-1]) / history.dt_s > over_mps2)
