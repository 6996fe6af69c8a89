"""An encounter in numbers: what the probability that the target fails in it is predicted from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.scene import HEAVY_CLASSES, AgentClass
from advdiff_sumo.traffic.manoeuvres.answers import BRAKING_MPS2
from advdiff_sumo.traffic.manoeuvres.manoeuvre import Manoeuvre
from advdiff_sumo.traffic.manoeuvres.repertoire import AS_GOOD_AS_STANDS_MPS, KINDS, crossing_links
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView

CIRCUMSTANCES = (
    "needed_braking",  # of a careful driver, in 5 m/s², 0 at 5 m/s²
    "target_speed",  # in 5 m/s, 0 at 10 m/s
    "closing_speed",  # target's less the other's along the target's heading, in 10 m/s
    "distance",  # of the centres, in 30 m, 0 at 30 m
    "brakes",  # hardest braking of the other, in 8 m/s²
    "heavy",  # the other is a truck or bus
    "unprotected",  # it is a motorcycle or bicycle
    "oncoming",  # it comes from ahead, heading within 60° of the opposite one
    "from_side",  # its heading is more than 60° off the target's, and it is not oncoming
    "aside",  # sine of its bearing from the target's heading, without sign
    "stands",  # it stands
    "red",  # the target has a red light where it would meet the other
)
"""Features after one flag for each of ``repertoire.KINDS``; about whom the target has to mind."""
FEATURES = (*KINDS, *CIRCUMSTANCES)
"""All D features; of two kinds no flag is 1 at once."""
UNPROTECTED = (AgentClass.MOTORCYCLE, AgentClass.BICYCLE)
_ACROSS = 0.5


def encounter_features(
    view: SituationView, manoeuvres: Sequence[Manoeuvre], needed_mps2: FloatArray
) -> FloatArray:
    """Return (C, D) features of *manoeuvres* as they begin, columns as in ``FEATURES``.

    Args:
        view: the scene; its target is on a lane.
        manoeuvres: C of them.
        needed_mps2: (C,) braking of a careful driver in the target's place.
    """
    out = np.zeros((len(manoeuvres), len(FEATURES)))
    for k, (manoeuvre, needed) in enumerate(zip(manoeuvres, needed_mps2.tolist(), strict=True)):
        out[k, FEATURES.index(manoeuvre.kind)] = 1.0
        out[k, len(KINDS) :] = _circumstances(view, manoeuvre, needed)
    return out


def with_vehicle(features: FloatArray, agent_class: AgentClass, oncoming: bool | None = None) -> FloatArray:
    """Return *features* (…, D) as they would be with another *agent_class*, and from ahead or the side if said so."""
    out = features.copy()
    out[..., FEATURES.index("heavy")] = agent_class in HEAVY_CLASSES
    out[..., FEATURES.index("unprotected")] = agent_class in UNPROTECTED
    if oncoming is not None:
        out[..., FEATURES.index("oncoming")] = oncoming
        out[..., FEATURES.index("from_side")] = not oncoming
    return out


def _circumstances(view: SituationView, manoeuvre: Manoeuvre, needed_mps2: float) -> tuple[float, ...]:
    now, target = view.scene.history, view.scene.target
    row = manoeuvre.row if manoeuvre.revealed_row is None else manoeuvre.revealed_row
    turned = float(np.cos(wrap_angle(float(now.yaw_rad[row, -1] - now.yaw_rad[target, -1]))))
    offset = now.xy_m[row, -1] - now.xy_m[target, -1]
    bearing = np.arctan2(offset[1], offset[0]) - now.yaw_rad[target, -1]
    profile, own, other = manoeuvre.profile, view.speed(target), view.speed(row)
    hardest = max(-profile.first_mps2, -profile.then_mps2, 0.0)
    return (
        min(needed_mps2, BRAKING_MPS2[-1]) / 5.0 - 1.0,
        own / 5.0 - 2.0,
        (own - other * turned) / 10.0,
        float(np.hypot(*offset)) / 30.0 - 1.0,
        hardest / 8.0,
        float(now.classes[row] in HEAVY_CLASSES),
        float(now.classes[row] in UNPROTECTED),
        float(turned < -_ACROSS),
        float(abs(turned) <= _ACROSS),
        abs(float(np.sin(bearing))),
        float(other < AS_GOOD_AS_STANDS_MPS),
        float(_is_red(view, manoeuvre)),
    )


def _is_red(view: SituationView, manoeuvre: Manoeuvre) -> bool:
    links = crossing_links(view, manoeuvre.row) if manoeuvre.kind == "crossing" else None
    return links is not None and view.is_red(links[1])
