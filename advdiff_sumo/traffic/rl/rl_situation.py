"""What the attacker of a scene is up to: who it is, what everybody would do by nature, what it observes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.plan import AttackState, JointPlan
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.decoder import Rollout
from advdiff_sumo.models.view import View
from advdiff_sumo.traffic.background_plan import Rules, empty_plan, outlook, plausible_plan, steps_driven
from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.planning.attackers import can_attack, choose
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.futures import futures_of
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.rl.features import FEATURES, observe
from advdiff_sumo.traffic.rl.prior import Prior
from advdiff_sumo.traffic.rl.steer import steered


@dataclass(frozen=True)
class AttackSituation:
    """A scene as attackers see it; R of them, none where nobody can reach the target.

    Attributes:
        view: the scene for the networks.
        lanes: row of the scene → the lanes that the vehicle would follow.
        natural: everybody's future by the behaviour model; None where nobody is moved.
        rows: (R,) attackers, rows of the view.
        observations: (R, F) what each observes.
    """

    view: View
    lanes: Mapping[int, LaneAhead | None]
    natural: Rollout | None
    rows: IntArray
    observations: FloatArray

    @property
    def attackers(self) -> tuple[str, ...]:
        """Names of the attackers."""
        return tuple(self.view.ids[row] for row in self.rows.tolist())


def situation(
    road: RoadMap, scene: Scene, prior: Prior, count: int, before: tuple[str, ...], licence: LicenceName
) -> AttackSituation:
    """Return the situation of at most *count* attackers.

    Args:
        road: the map.
        scene: now.
        prior: the behaviour model.
        count: most attackers.
        before: who attacked last; they stay where they still can do something.
        licence: what attackers may do.
    """
    view, lanes = outlook(road, scene, prior.options.map_view)
    if not view.moved.any():
        return AttackSituation(view, lanes, None, np.zeros(0, dtype=np.int64), np.zeros((0, FEATURES)))
    natural = prior.rollout(view.batch)
    futures = futures_of(view.now, natural)
    may = can_attack(futures, view.moved, licence)
    rows = choose(futures, may, "any", count, np.isin(view.ids, before))
    observations = [
        observe(road, view.now, futures, row, lanes.get(int(view.rows[row])), _actions(natural, row))
        for row in rows.tolist()
    ]
    return AttackSituation(view, lanes, natural, rows, np.array(observations).reshape(len(rows), FEATURES))


def joint_plan(
    road: RoadMap,
    now: AttackSituation,
    prior: Prior,
    residuals: FloatArray,
    before: Tracks | None,
    licence: LicenceName,
) -> JointPlan:
    """Return the plan in which attackers deviate, made plausible as every policy's.

    Args:
        road: the map.
        now: the situation.
        prior: the behaviour model.
        residuals: (R, 2) deviations in [−1, 1].
        before: the plan before; who cannot stop in time may go on with it.
        licence: what attackers may do.
    """
    if now.natural is None:
        return JointPlan(empty_plan(now.view.scene), attack=AttackState("any"))
    rows = torch.from_numpy(now.rows)
    rollout = steered(now.natural, now.view.batch, rows, torch.from_numpy(residuals), prior.options)
    drawn = Drawn(rollout, {}, now.attackers, torch.zeros(len(now.view.ids), 0))
    last = before, steps_driven(before, now.view.scene)
    plan = plausible_plan(road, now.view, now.lanes, drawn, last, Rules(licence, len(now.rows)))
    return JointPlan(plan.tracks, attack=AttackState("any", plan.attackers), safeguarded=plan.safeguarded)


def _actions(natural: Rollout, row: int) -> tuple[float, float]:
    return float(natural.accel[0, row, 0]), float(natural.curvature[0, row, 0])
