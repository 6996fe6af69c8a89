"""Chooses the manoeuvre that asks most of the target while a careful driver still answers it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.answers import (
    TargetWay,
    contact_share,
    notices_no_stop_s,
    trapped_share,
)
from advdiff_sumo.traffic.manoeuvres.demanded_braking import demanded_braking
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference
from advdiff_sumo.traffic.manoeuvres.graded import severity_match
from advdiff_sumo.traffic.manoeuvres.intensity import ANY_SEVERITY, Intensity
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    DOUBLE,
    MAX_DEMAND_MPS2,
    SLOW_ENTRIES,
    crossing_links,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

HARD_BRAKING_MERIT: Mapping[float, float] = {3.0: 0.4, 4.0: 0.7, 5.0: 0.9, 6.0: 1.0, 7.0: 0.8}
"""Worth of an encounter by the braking that it needs; none where it needs little or more than a driver has."""
YIELDING_MERIT: Mapping[float, float] = {1.0: 0.6, 2.0: 0.8, 3.0: 0.8, 4.0: 0.7, 5.0: 0.5, 6.0: 0.3}
"""Worth where what counts is whether the target sees the other and gives way at all."""
CUT_IN_MERIT: Mapping[float, float] = {2.0: 0.4, 3.0: 0.6, 4.0: 0.8, 5.0: 0.9, 6.0: 1.0, 7.0: 0.7}
"""Worth where both count."""
SLOW_ENTRY_MERIT: Mapping[float, float] = {1.0: 0.3, 2.0: 0.6, 3.0: 0.8, 4.0: 1.0, 5.0: 0.8}
"""Worth where somebody enters slowly, whom the target sees before; none beyond ``MOST_DEMANDED_MPS2``."""
_LEAST_SEEN_MPS2: Mapping[str, float] = {"blocked-lane": 2.0, "cut-out": 2.0, "crossing": 1.0}
_GENTLE_SHARE = 0.5
"""Who stops gently asks less than who stops hard a little later."""
_TRAPPED, _WAITS, _UNNOTICED_S = 0.8, 0.3, 1.0
_UNCERTAIN = 0.2
"""Share of its worth that somebody keeps who would meet the target at the very instant alone."""
POSITIONING_MERIT, _ASKS_MPS2 = 0.05, {"hard-stop": 2.0, DOUBLE: 2.0}
"""Worth of getting into position, and what it may ask of the target: 1 m/s², or as a leader that it closes up to."""


@dataclass(frozen=True)
class Chosen:
    """A lawful manoeuvre and its future.

    Attributes:
        manoeuvre: what.
        futures: of it alone, C = 1.
        needed_mps2: braking of the target that it needs.
        merit: how well it serves, however much its kind is wanted.
        features: of the encounter, see ``encounter_features``; () where none is preferred.
    """

    manoeuvre: Manoeuvre
    futures: ManoeuvreFutures
    needed_mps2: float
    merit: float = 1.0
    features: tuple[float, ...] = ()


def rank(
    view: SituationView,
    proposals: Sequence[Manoeuvre],
    weights: Mapping[str, float],
    licence: Licence | None = LAWFUL,
    intensity: Intensity = ANY_SEVERITY,
    begun: bool = False,
    preference: EncounterPreference | None = None,
) -> list[Chosen]:
    """Return those of *proposals* that keep to *licence* and serve at all, best first.

    Args:
        view: the scene.
        proposals: manoeuvres of any vehicles.
        weights: kind → how much it is wanted.
        licence: what they may do; None: anything.
        intensity: where a severity is asked for, a manoeuvre serves by how near it comes.
        begun: whether they are under way, so that the target has had its time to answer.
        preference: of encounters in which the target is predicted to fail; None: nothing is known.
    """
    target = view.target
    if target is None or not proposals:
        return []
    futures = futures_of_manoeuvres(proposals, np.array([view.speed(m.row) for m in proposals]))
    needed = demanded_braking(view, target, proposals, futures)
    merit = _merits(view, proposals, futures, needed, intensity, begun)
    worth = merit * np.array([weights.get(m.kind, 0.0) for m in proposals])
    features: Sequence[tuple[float, ...]] = [()] * len(proposals)
    if preference is not None:
        features, factors = preference.rate(view, proposals, needed)
        worth = worth * factors
    useful = np.flatnonzero(worth > 0.0)
    kept = useful[
        lawful_mask(view, [proposals[k] for k in useful.tolist()], _rows(futures, useful), licence, begun)
    ]
    order = kept[np.argsort(-worth[kept], kind="stable")].tolist()
    return [
        Chosen(
            proposals[k],
            _rows(futures, np.array([k])),
            float(needed[k]),
            float(merit[k]),
            features[k],
        )
        for k in order
    ]


def _merits(
    view: SituationView,
    proposals: Sequence[Manoeuvre],
    futures: ManoeuvreFutures,
    needed: FloatArray,
    intensity: Intensity,
    begun: bool,
) -> FloatArray:
    """Return (N,) how well each proposal serves, given the braking (N,) *needed* of the target; see :func:`rank`."""
    target = view.target
    merit = np.array([_merit(m, n, begun) for m, n in zip(proposals, needed.tolist(), strict=True)])
    timed = np.flatnonzero([m.kind == "crossing" and not m.sets_up for m in proposals])
    if target is not None and len(timed):
        crossing = [proposals[k] for k in timed.tolist()]
        of_them, size = _rows(futures, timed), view.scene.history.size_m[[m.row for m in crossing]]
        merit[timed] *= _certain(contact_share(target, of_them.xy_m, of_them.yaw_rad, size))
        at_red = _merit_at_red(view, target, crossing, of_them, size)
        if begun:
            merit[timed] = np.where(np.isnan(at_red), merit[timed], at_red)
        else:
            merit[timed] *= np.where(at_red < _TRAPPED * _WAITS, _UNCERTAIN, 1.0)  # it is seen to come
    for k, manoeuvre in enumerate(proposals):
        near = severity_match(view, manoeuvre, futures.driven_m[k], intensity)
        merit[k] = merit[k] if near is None else near
    return merit


def _certain(share: FloatArray) -> FloatArray:
    """Return which share of its worth somebody keeps who meets the target in *share* of the cases."""
    return _UNCERTAIN + (1.0 - _UNCERTAIN) * share


def _merit_at_red(
    view: SituationView,
    target: TargetWay,
    crossing: Sequence[Manoeuvre],
    futures: ManoeuvreFutures,
    size_m: FloatArray,
) -> FloatArray:
    """Return (C,) how well each of *crossing* goes on before a target with a red light; NaN where it has none.

    A target that goes on over it believes that the others stop: what counts is whether there is a way out when it
    notices that they no longer can, else that it does not notice yet.
    """
    share = contact_share(target, futures.xy_m, futures.yaw_rad, size_m)
    notices_s = np.full(len(crossing), np.nan)
    for k, manoeuvre in enumerate(crossing):
        links = crossing_links(view, manoeuvre.row)
        if links is not None and view.is_red(links[1]):
            reach = next(reach for reach, link in manoeuvre.way.links if link is links[0])
            to_line_m = reach - 0.5 * float(size_m[k, 0])
            notices_s[k] = notices_no_stop_s(
                to_line_m, view.speed(manoeuvre.row), futures.driven_m[k], futures.speed_mps[k]
            )
    trapped = trapped_share(target, futures.xy_m, futures.yaw_rad, size_m, notices_s)
    surprise = np.maximum(trapped, np.where(notices_s > _UNNOTICED_S, _WAITS, 0.0))
    merit = _TRAPPED * surprise + (1.0 - _TRAPPED) * _certain(share)
    return np.where(np.isnan(notices_s), np.nan, merit)


def _merit(manoeuvre: Manoeuvre, needed_mps2: float, begun: bool) -> float:
    if manoeuvre.sets_up:
        return POSITIONING_MERIT if needed_mps2 <= _ASKS_MPS2.get(manoeuvre.kind, 1.0) else 0.0
    if manoeuvre.kind == "cut-in":
        return CUT_IN_MERIT.get(needed_mps2, 0.0)
    if manoeuvre.kind in SLOW_ENTRIES:
        most = MAX_DEMAND_MPS2[manoeuvre.kind]
        return SLOW_ENTRY_MERIT.get(needed_mps2, 0.0) if needed_mps2 <= most else 0.0
    if manoeuvre.kind == "crossing" and begun:
        return float(needed_mps2 > 0.0)
    least = _LEAST_SEEN_MPS2.get(manoeuvre.kind)
    if least is None:
        return HARD_BRAKING_MERIT.get(needed_mps2, 0.0)
    share = _GENTLE_SHARE if manoeuvre.kind == "blocked-lane" else 1.0
    return share * YIELDING_MERIT.get(needed_mps2, 0.0) if needed_mps2 >= least else 0.0


def _rows(futures: ManoeuvreFutures, rows: FloatArray | np.ndarray) -> ManoeuvreFutures:
    return replace(futures.mapped(lambda part: part[rows]), driven_m=futures.driven_m[rows])
