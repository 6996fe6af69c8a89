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
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.view import View, look
from advdiff_sumo.traffic.diffusion.diffusion_policy import apply_safeguard, lanes_of, leaving, tracks_of
from advdiff_sumo.traffic.manoeuvres.licence import LicenceName
from advdiff_sumo.traffic.manoeuvres.licensed_attack import licensed_attack
from advdiff_sumo.traffic.planning.attackers import choose
from advdiff_sumo.traffic.planning.draw import Drawn
from advdiff_sumo.traffic.planning.futures import futures_of
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead
from advdiff_sumo.traffic.rl.features import FEATURES, observe
from advdiff_sumo.traffic.rl.prior import Prior
from advdiff_sumo.traffic.rl.steer import steered


@dataclass(frozen=True)
class Situation:
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


def situation(road: RoadMap, scene: Scene, prior: Prior, count: int, before: tuple[str, ...]) -> Situation:
    """Return the situation of at most *count* attackers.

    Args:
        road: the map.
        scene: now.
        prior: the behaviour model.
        count: most attackers.
        before: who attacked last; they stay where they still can do something.
    """
    lanes = lanes_of(road, scene)
    view = look(road, scene, leaving(scene, lanes))
    if not view.moved.any():
        return Situation(view, lanes, None, np.zeros(0, dtype=np.int64), np.zeros((0, FEATURES)))
    natural = prior.rollout(view.batch)
    futures = futures_of(view.now, natural)
    rows = choose(futures, view.moved, "any", count, np.isin(view.ids, before))
    seen = [
        observe(road, view.now, futures, row, lanes.get(int(view.rows[row])), _actions(natural, row))
        for row in rows.tolist()
    ]
    return Situation(view, lanes, natural, rows, np.array(seen).reshape(len(rows), FEATURES))


def joint_plan(
    road: RoadMap,
    now: Situation,
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
        before: the plan before, of which one model step has been driven; who cannot stop in time may go on with it.
        licence: what attackers may do.
    """
    if now.natural is None:
        t0 = now.view.scene.time_s + MODEL_STEP_S
        return JointPlan(Tracks.empty(steps=1, dt_s=MODEL_STEP_S, t0_s=t0), attack=AttackState("any"))
    rows = torch.from_numpy(now.rows)
    made = steered(now.natural, now.view.batch, rows, torch.from_numpy(residuals), prior.options)
    drawn = Drawn(made, {}, now.attackers, torch.zeros(len(now.view.ids), 0))
    futures = futures_of(now.view.now, made)
    attack = licensed_attack(road, now.view, futures, now.attackers, licence, None, len(now.rows))
    guarded = apply_safeguard(road, now.view, drawn, now.lanes, (before, 1), attack)
    return JointPlan(tracks_of(now.view, guarded.futures), attack=AttackState("any", now.attackers))


def _actions(natural: Rollout, row: int) -> tuple[float, float]:
    return float(natural.accel[0, row, 0]), float(natural.curvature[0, row, 0])
