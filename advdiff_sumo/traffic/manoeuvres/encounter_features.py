"""Features of an encounter, from which the probability that the target fails in it is predicted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import HEAVY_CLASSES, AgentClass
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.repertoire import KINDS, STANDING_BELOW_MPS, crossing_links
from advdiff_sumo.traffic.manoeuvres.required_braking import BRAKING_MPS2
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

CIRCUMSTANCES = (
    "needed_braking",  # required deceleration of a careful driver, in 5 m/s², 0 at 5 m/s²
    "target_speed",  # in 5 m/s, 0 at 10 m/s
    "closing_speed",  # of the target, relative to the other along the target's heading, in 10 m/s
    "distance",  # of the centres, in 30 m, 0 at 30 m
    "brakes",  # hardest braking of the other, in 8 m/s²
    "heavy",  # the other is a truck or bus
    "unprotected",  # it is a motorcycle or bicycle
    "oncoming",  # its heading is within 60° of the opposite of the target's
    "from_side",  # its heading is more than 60° off the target's, and it is not oncoming
    "aside",  # absolute sine of its bearing from the target's heading
    "stands",  # it stands
    "red",  # the target has a red light where it would meet the other
)
"""Features of the other vehicle, which follow one flag for each of ``repertoire.KINDS``."""
FEATURES = (*KINDS, *CIRCUMSTANCES)
"""All D features; exactly one flag of a kind is 1."""
UNPROTECTED = (AgentClass.MOTORCYCLE, AgentClass.BICYCLE)
_ACROSS = 0.5  # cosine of 60°


def encounter_features(
    view: SituationView, manoeuvres: Sequence[Manoeuvre], needed_mps2: FloatArray
) -> FloatArray:
    """Return (C, D) features of *manoeuvres* as they begin, columns as in ``FEATURES``.

    Args:
        view: the scene; its target is on a lane.
        manoeuvres: C of them.
        needed_mps2: (C,) required deceleration of a careful driver in the target's place.
    """
    features = np.zeros((len(manoeuvres), len(FEATURES)))
    for k, (manoeuvre, needed) in enumerate(zip(manoeuvres, needed_mps2.tolist(), strict=True)):
        features[k, FEATURES.index(manoeuvre.kind)] = 1.0
        features[k, len(KINDS) :] = _circumstances(view, manoeuvre, needed)
    return features


def with_vehicle(features: FloatArray, agent_class: AgentClass, oncoming: bool | None = None) -> FloatArray:
    """Return *features* (…, D) with another *agent_class* and, unless *oncoming* is None, from ahead or the side."""
    changed = features.copy()
    changed[..., FEATURES.index("heavy")] = agent_class in HEAVY_CLASSES
    changed[..., FEATURES.index("unprotected")] = agent_class in UNPROTECTED
    if oncoming is not None:
        changed[..., FEATURES.index("oncoming")] = oncoming
        changed[..., FEATURES.index("from_side")] = not oncoming
    return changed


def _circumstances(view: SituationView, manoeuvre: Manoeuvre, needed_mps2: float) -> tuple[float, ...]:
    """Return the values of ``CIRCUMSTANCES`` for one manoeuvre."""
    history, target = view.scene.history, view.scene.target
    row = manoeuvre.row if manoeuvre.revealed_row is None else manoeuvre.revealed_row
    cosine = float(np.cos(wrap_angle(float(history.yaw_rad[row, -1] - history.yaw_rad[target, -1]))))
    offset = history.xy_m[row, -1] - history.xy_m[target, -1]
    bearing = np.arctan2(offset[1], offset[0]) - history.yaw_rad[target, -1]
    profile, target_mps, other_mps = manoeuvre.profile, view.speed(target), view.speed(row)
    hardest = max(-profile.first_mps2, -profile.then_mps2, 0.0)
    return (
        min(needed_mps2, BRAKING_MPS2[-1]) / 5.0 - 1.0,
        target_mps / 5.0 - 2.0,
        (target_mps - other_mps * cosine) / 10.0,
        float(np.hypot(*offset)) / 30.0 - 1.0,
        hardest / 8.0,
        float(history.classes[row] in HEAVY_CLASSES),
        float(history.classes[row] in UNPROTECTED),
        float(cosine < -_ACROSS),
        float(abs(cosine) <= _ACROSS),
        abs(float(np.sin(bearing))),
        float(other_mps < STANDING_BELOW_MPS),
        float(_target_has_red(view, manoeuvre)),
    )


def _target_has_red(view: SituationView, manoeuvre: Manoeuvre) -> bool:
    links = crossing_links(view, manoeuvre.row) if manoeuvre.kind == "crossing" else None
    return links is not None and view.is_red(links[1])
