"""Prepares a scene for ``adv-rl``: natural futures, attackers and their observations; and makes the plan."""

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
from advdiff_sumo.traffic.background_plan import (
    Rules,
    empty_plan,
    plausible_plan,
    steps_driven,
    view_and_lanes,
)
from advdiff_sumo.traffic.licence import LicenceName
from advdiff_sumo.traffic.planning.attackers import can_attack, choose
from advdiff_sumo.traffic.planning.drawn import Drawn
from advdiff_sumo.traffic.planning.futures import futures_of
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.rl.features import FEATURES, observe
from advdiff_sumo.traffic.rl.prior import Prior
from advdiff_sumo.traffic.rl.steer import steered_futures


@dataclass(frozen=True)
class AttackSituation:
    """A scene with its R attackers; none if no vehicle can reach the target.

    Attributes:
        view: the scene as the networks see it.
        lanes: row of the scene → lanes that the vehicle would follow.
        natural: all futures by the behaviour model; None if no vehicle is moved.
        rows: (R,) rows of the attackers in the view.
        observations: (R, F) observation of each attacker.
    """

    view: View
    lanes: Mapping[int, LaneAhead | None]
    natural: Rollout | None
    rows: IntArray
    observations: FloatArray

    @property
    def attackers(self) -> tuple[str, ...]:
        """Ids of the attackers."""
        return tuple(self.view.ids[row] for row in self.rows.tolist())


def situation(
    road: RoadMap, scene: Scene, prior: Prior, count: int, before: tuple[str, ...], licence: LicenceName
) -> AttackSituation:
    """Return the situation of at most *count* attackers.

    Args:
        road: the map.
        scene: the present scene.
        prior: the behaviour model.
        count: largest number of attackers.
        before: ids of the previous attackers, which are preferred if they still can attack.
        licence: what attackers may do.
    """
    view, lanes = view_and_lanes(road, scene, prior.options.map_view)
    if not view.moved.any():
        return AttackSituation(view, lanes, None, np.zeros(0, dtype=np.int64), np.zeros((0, FEATURES)))
    natural = prior.rollout(view.batch)
    futures = futures_of(view.now, natural)
    candidates = can_attack(futures, view.moved, licence)
    rows = choose(futures, candidates, "any", count, np.isin(view.ids, before))
    observations = [
        observe(road, view.now, futures, row, lanes.get(int(view.rows[row])), _next_action(natural, row))
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
    """Return the plan in which attackers deviate, after licence and safeguard.

    Args:
        road: the map.
        now: the situation.
        prior: the behaviour model.
        residuals: (R, 2) deviations in [−1, 1].
        before: the previous plan, which a vehicle that cannot stop in time may continue.
        licence: what attackers may do.
    """
    if now.natural is None:
        return JointPlan(empty_plan(now.view.scene), attack=AttackState("any"))
    rows = torch.from_numpy(now.rows)
    rollout = steered_futures(now.natural, now.view.batch, rows, torch.from_numpy(residuals), prior.options)
    drawn = Drawn(rollout, {}, now.attackers, torch.zeros(len(now.view.ids), 0))
    previous = before, steps_driven(before, now.view.scene)
    plan = plausible_plan(road, now.view, now.lanes, drawn, previous, Rules(licence, len(now.rows)))
    return JointPlan(plan.tracks, attack=AttackState("any", plan.attackers), safeguarded=plan.safeguarded)


def _next_action(natural: Rollout, row: int) -> tuple[float, float]:
    return float(natural.accel[0, row, 0]), float(natural.curvature[0, row, 0])
