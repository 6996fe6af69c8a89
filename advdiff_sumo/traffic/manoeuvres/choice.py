"""Chooses the manoeuvre that is hardest for the target but still within what a careful driver can do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.traffic.licence import LAWFUL, Licence
from advdiff_sumo.traffic.manoeuvres.demanded_braking import demanded_braking
from advdiff_sumo.traffic.manoeuvres.encounter_preference import EncounterPreference
from advdiff_sumo.traffic.manoeuvres.intensity import ANY_SEVERITY, Intensity
from advdiff_sumo.traffic.manoeuvres.licence_rules import lawful_mask
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreFutures, futures_of_manoeuvres
from advdiff_sumo.traffic.manoeuvres.prescribed_severity import severity_match
from advdiff_sumo.traffic.manoeuvres.repertoire import (
    BESIDE_KINDS,
    DOUBLE,
    MAX_DEMAND_MPS2,
    SLOW_ENTRIES,
    crossing_links,
)
from advdiff_sumo.traffic.manoeuvres.required_braking import (
    TargetWay,
    contact_share,
    notices_no_stop_s,
    trapped_share,
)
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

HARD_BRAKING_MERIT: Mapping[float, float] = {3.0: 0.4, 4.0: 0.7, 5.0: 0.9, 6.0: 1.0, 7.0: 0.8}
"""Merit of an encounter by the required deceleration of the target; 0 if that is small or not possible."""
YIELDING_MERIT: Mapping[float, float] = {1.0: 0.6, 2.0: 0.8, 3.0: 0.8, 4.0: 0.7, 5.0: 0.5, 6.0: 0.3}
"""Merit of an encounter that tests whether the target perceives the other and yields at all."""
CUT_IN_MERIT: Mapping[float, float] = {2.0: 0.4, 3.0: 0.6, 4.0: 0.8, 5.0: 0.9, 6.0: 1.0, 7.0: 0.7}
"""Merit of a cut-in, which tests both."""
SLOW_ENTRY_MERIT: Mapping[float, float] = {1.0: 0.3, 2.0: 0.6, 3.0: 0.8, 4.0: 1.0, 5.0: 0.8}
"""Merit of a slow entry, which the target sees beforehand; 0 beyond ``MAX_DEMAND_MPS2``."""
_LEAST_DEMAND_MPS2: Mapping[str, float] = {"blocked-lane": 2.0, "cut-out": 2.0, "crossing": 1.0}
"""Least required deceleration of the kinds that are rated by ``YIELDING_MERIT``."""
_GENTLE_FACTOR = 0.5  # on the merit of a blocked lane, so that a hard stop a little later is preferred
_TRAPPED_WEIGHT = 0.8  # of a target that cannot escape, in the merit of a crossing at its red light
_UNNOTICED_SHARE, _UNNOTICED_S = 0.3, 1.0
"""Trapped share that is assumed if the target notices a crossing vehicle only after this time."""
_ONE_INSTANT_FACTOR = 0.2
"""Factor on the merit of a crossing vehicle that collides only if it arrives at exactly one instant."""
POSITIONING_MERIT, _POSITIONING_DEMAND_MPS2 = 0.05, {"hard-stop": 2.0, DOUBLE: 2.0}
"""Merit of getting into position; deceleration that it may require: 1 m/s², or 2 to close up to a leader."""


@dataclass(frozen=True)
class Chosen:
    """A lawful manoeuvre and its future.

    Attributes:
        manoeuvre: the manoeuvre.
        futures: its future, C = 1.
        needed_mps2: the required deceleration of the target.
        merit: how good a test it is, 0 to 1, without the weight of its kind.
        features: features of the encounter, see ``encounter_features``; () if there is no preference.
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
    """Return those of *proposals* that keep to *licence* and have any merit, best first.

    Args:
        view: the scene.
        proposals: manoeuvres of any vehicles.
        weights: kind → weight of its merit.
        licence: what they may do; None: anything.
        intensity: a prescribed severity; the merit is then how near a manoeuvre comes to it.
        begun: whether they are under way, so that the target has had its time to respond.
        preference: for encounters in which the target is predicted to fail; None: nothing is predicted.
    """
    target = view.target
    if target is None or not proposals:
        return []
    futures = futures_of_manoeuvres(proposals, np.array([view.speed(m.row) for m in proposals]))
    needed = demanded_braking(view, target, proposals, futures)
    merit = _merits(view, proposals, futures, needed, intensity, begun)
    score = merit * np.array([weights.get(m.kind, 0.0) for m in proposals])
    features: Sequence[tuple[float, ...]] = [()] * len(proposals)
    if preference is not None:
        features, factors = preference.rate(view, proposals, needed)
        score = score * factors
    useful = np.flatnonzero(score > 0.0)
    lawful_rows = useful[
        lawful_mask(view, [proposals[k] for k in useful.tolist()], _rows(futures, useful), licence, begun)
    ]
    order = lawful_rows[np.argsort(-score[lawful_rows], kind="stable")].tolist()
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
    """Return (N,) merits of the proposals, given the required deceleration (N,) *needed*; see :func:`rank`."""
    target = view.target
    merit = np.array([_merit(m, n, begun) for m, n in zip(proposals, needed.tolist(), strict=True)])
    rows = np.flatnonzero([m.kind == "crossing" and not m.is_positioning for m in proposals])
    if target is not None and len(rows):
        crossings = [proposals[k] for k in rows.tolist()]
        crossing_futures, size = _rows(futures, rows), view.scene.history.size_m[[m.row for m in crossings]]
        share = contact_share(target, crossing_futures.xy_m, crossing_futures.yaw_rad, size)
        merit[rows] *= _contact_factor(share)
        at_red = _merit_at_red(view, target, crossings, crossing_futures, size)
        if begun:
            merit[rows] = np.where(np.isnan(at_red), merit[rows], at_red)
        else:  # less if the target notices in time that the vehicle does not stop
            merit[rows] *= np.where(at_red < _TRAPPED_WEIGHT * _UNNOTICED_SHARE, _ONE_INSTANT_FACTOR, 1.0)
    for k, manoeuvre in enumerate(proposals):
        match = severity_match(view, manoeuvre, futures.driven_m[k], float(needed[k]), intensity)
        merit[k] = merit[k] if match is None else match
    return merit


def _contact_factor(share: FloatArray) -> FloatArray:
    """Return the factor on the merit of a vehicle that meets the target in *share* of the cases."""
    return _ONE_INSTANT_FACTOR + (1.0 - _ONE_INSTANT_FACTOR) * share


def _merit_at_red(
    view: SituationView,
    target: TargetWay,
    crossings: Sequence[Manoeuvre],
    futures: ManoeuvreFutures,
    size_m: FloatArray,
) -> FloatArray:
    """Return (C,) merits of *crossings* before a target with a red light; NaN where it has none.

    A target that runs the light expects the others to stop. The merit is high if it can no longer escape when it
    notices that they cannot, and lower if it does not notice for some time.
    """
    share = contact_share(target, futures.xy_m, futures.yaw_rad, size_m)
    notices_s = np.full(len(crossings), np.nan)
    for k, manoeuvre in enumerate(crossings):
        links = crossing_links(view, manoeuvre.row)
        if links is not None and view.is_red(links[1]):
            line_m = next(line_m for line_m, link in manoeuvre.way.links if link is links[0])
            to_line_m = line_m - 0.5 * float(size_m[k, 0])
            notices_s[k] = notices_no_stop_s(
                to_line_m, view.speed(manoeuvre.row), futures.driven_m[k], futures.speed_mps[k]
            )
    trapped = trapped_share(target, futures.xy_m, futures.yaw_rad, size_m, notices_s)
    surprise = np.maximum(trapped, np.where(notices_s > _UNNOTICED_S, _UNNOTICED_SHARE, 0.0))
    merit = _TRAPPED_WEIGHT * surprise + (1.0 - _TRAPPED_WEIGHT) * _contact_factor(share)
    return np.where(np.isnan(notices_s), np.nan, merit)


def _merit(manoeuvre: Manoeuvre, needed_mps2: float, begun: bool) -> float:
    """Return the merit by the kind of manoeuvre and the required deceleration of the target."""
    if manoeuvre.is_positioning:
        most = _POSITIONING_DEMAND_MPS2.get(manoeuvre.kind, 1.0)
        return POSITIONING_MERIT if needed_mps2 <= most else 0.0
    if manoeuvre.kind in BESIDE_KINDS:
        return float(needed_mps2 == 0.0)  # the target need only keep its lane
    if manoeuvre.kind == "cut-in":
        return CUT_IN_MERIT.get(needed_mps2, 0.0)
    if manoeuvre.kind in SLOW_ENTRIES:
        most = MAX_DEMAND_MPS2[manoeuvre.kind]
        return SLOW_ENTRY_MERIT.get(needed_mps2, 0.0) if needed_mps2 <= most else 0.0
    if manoeuvre.kind == "crossing" and begun:
        return float(needed_mps2 > 0.0)
    least = _LEAST_DEMAND_MPS2.get(manoeuvre.kind)
    if least is None:
        return HARD_BRAKING_MERIT.get(needed_mps2, 0.0)
    factor = _GENTLE_FACTOR if manoeuvre.kind == "blocked-lane" else 1.0
    return factor * YIELDING_MERIT.get(needed_mps2, 0.0) if needed_mps2 >= least else 0.0


def _rows(futures: ManoeuvreFutures, rows: FloatArray | np.ndarray) -> ManoeuvreFutures:
    """Return the futures at *rows*."""
    return replace(futures.mapped(lambda part: part[rows]), driven_m=futures.driven_m[rows])
