"""Searches for a trajectory of the target that avoids a recorded collision: Strive's solution stage.

After Rempe et al. 2022 (Sec. 3.3, doi:10.1109/CVPR52688.2022.01679): a scenario is solvable if the target has a
trajectory that touches nobody and stays on the road, while all others move as recorded. Strive searches the target's
latent. This search optimises its actions, starting from samples of the traffic model and from simple manoeuvres, and
also tries to brake on the recorded path. All candidates are checked with the exact boxes at the simulation's step.
Others do not react, so a trajectory that needs their reaction does not count: the share of solvable scenarios is a
lower bound. As in the verdict, a third vehicle may run into the target's rear: keeping the distance is its duty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners, separation
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.experiments.solution_check import TargetSurroundings, braked, drive, surroundings, usable
from advdiff_sumo.experiments.solution_search import search
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.models.model_options import FUTURE_STEPS, HISTORY_STEPS, MODEL_STEP_S
from advdiff_sumo.models.view import View, look
from advdiff_sumo.traffic.baselines.baseline_networks import prior_of
from advdiff_sumo.traffic.baselines.baseline_options import BaselineOptions

BEFORE_S, AFTER_S = 5.0, 1.0
"""The search begins ``BEFORE_S`` before the collision and ends ``AFTER_S`` after it."""


class SolveOptions(Options):
    """Options of the search.

    Attributes:
        draws: sampled futures of the traffic model to start from, in addition to the simple manoeuvres.
        rounds: steps of Adam from every start.
        seed: of the samples.
        weights: a bundle of networks; empty: the shipped one.
        device: as for the background policies.
    """

    draws: int = Field(6, ge=1, le=256)
    rounds: int = Field(60, ge=0, le=10000)
    seed: int = Field(0, ge=0)
    weights: str = ""
    device: str = "auto"


@dataclass(frozen=True)
class Solution:
    """The result of the search.

    Attributes:
        solvable: whether a solution was found.
        begin_s: when the trajectories branch off the recorded one, since the episode's start.
        contact_s: when the recorded one collides, since the episode's start.
        states: (T + 1, 4) x, y, yaw, speed of the target at the record's step from ``begin_s`` on, of the solution with
            the least effort; None if there is none.
        effort_mps2: root mean square of its lateral and longitudinal acceleration; NaN if there is none.
        tried: number of trajectories checked.
        free: how many of them are solutions.
    """

    solvable: bool
    begin_s: float
    contact_s: float
    states: FloatArray | None
    effort_mps2: float
    tried: int
    free: int


@one_thread()
def solve(
    episode: EpisodeStates, road: RoadMap, options: SolveOptions | None = None, contact: int | None = None
) -> Solution:
    """Search for a trajectory by which the target of *episode* would have avoided its collision.

    The trajectories begin ``BEFORE_S`` before the contact, or when the target appears. Beyond the end of the record,
    the others keep their velocities.

    Args:
        episode: its states.
        road: its net.
        options: of the search.
        contact: index of the first instant with overlapping boxes. None: it is found from the boxes; if they never
            overlap, as the contact may lie between two instants, the last instant.

    Raises:
        WeightsError: the networks are missing or unusable.
        ConfigError: no such device.
    """
    options = options or SolveOptions()
    tracks = episode.tracks
    contact = first_contact_step(tracks, episode.target) if contact is None else contact
    stride = max(round(MODEL_STEP_S / tracks.dt_s), 1)
    absent_steps = np.flatnonzero(~tracks.valid[episode.target, :contact])
    earliest_step = int(absent_steps[-1]) + 1 if absent_steps.size else 0
    begin_step = max(contact - round(BEFORE_S / tracks.dt_s), earliest_step)
    needed_s = (contact - begin_step) * tracks.dt_s + AFTER_S
    steps = min(int(np.ceil(needed_s / MODEL_STEP_S - 1e-9)), FUTURE_STEPS)
    around = surroundings(tracks, episode.target, begin_step, steps * stride)
    network_options = BaselineOptions(weights=options.weights, device=options.device)
    prior = prior_of(network_options, "the solution stage")
    view = look(road, _scene(tracks, episode.target, begin_step, stride), map_view=prior.map_view)
    others = _model_steps(around, view, stride)
    search_result = search(prior, view, others, steps, options.draws, options.rounds, options.seed)
    braking_actions = braked(tracks, episode.target, begin_step, steps, tracks.dt_s * stride)
    accel = np.concatenate((search_result.accel_mps2, braking_actions[0]))
    curvature = np.concatenate((search_result.curvature_1pm, braking_actions[1]))
    trajectories = drive(around, accel, curvature, stride)
    is_solution = usable(road, around, trajectories, met_by(tracks, episode.target, contact))
    lateral_accel = curvature * trajectories[:, stride::stride, 3] ** 2
    effort_mps2 = np.sqrt((accel**2 + lateral_accel**2).mean(axis=1))
    return _solution(begin_step * tracks.dt_s, contact * tracks.dt_s, trajectories, is_solution, effort_mps2)


def first_contact_step(tracks: Tracks, target: int) -> int:
    """Return the first instant at which the box of *target* overlaps another one, else its last instant."""
    touching_steps = np.flatnonzero((_gaps(tracks, target) < 0.0).any(axis=0))
    return int(touching_steps[0]) if len(touching_steps) else int(np.flatnonzero(tracks.valid[target])[-1])


def met_by(tracks: Tracks, target: int, contact: int) -> frozenset[str]:
    """Return the ids of all whose boxes overlap that of *target* up to *contact*, and of the nearest one then."""
    gaps = _gaps(tracks, target)[:, : contact + 1]
    rows = {int(np.argmin(gaps[:, -1])), *np.flatnonzero((gaps < 0.0).any(axis=1)).tolist()}
    return frozenset(tracks.ids[row] for row in rows)


def _gaps(tracks: Tracks, target: int) -> FloatArray:
    """Return the signed gaps (A, T) of all boxes to that of *target*; inf for itself and for absent road users."""
    boxes = corners(tracks.xy_m, tracks.yaw_rad, np.repeat(tracks.size_m[:, None], tracks.steps, axis=1))
    with np.errstate(invalid="ignore"):
        gaps = separation(boxes, np.broadcast_to(boxes[target], boxes.shape))
    gaps[target] = np.inf
    return np.where(np.isnan(gaps), np.inf, gaps)


def _scene(tracks: Tracks, target: int, begin: int, stride: int) -> Scene:
    """Return the scene at instant *begin* with its history at model steps; unrecorded states are masked."""
    present_rows = np.flatnonzero(tracks.valid[:, begin])
    steps = begin - stride * np.arange(HISTORY_STEPS - 1, -1, -1)
    is_recorded, steps = steps >= 0, np.maximum(steps, 0)
    t0_s = tracks.t0_s + tracks.dt_s * (begin - stride * (HISTORY_STEPS - 1))
    history = tracks.rows(present_rows).at(steps, t0_s, tracks.dt_s * stride)
    history = history.where(history.valid & is_recorded)
    target_row = int(np.flatnonzero(present_rows == target)[0])
    is_movable = np.arange(len(present_rows)) != target_row
    return Scene(history, target_row, is_movable, ((),) * len(present_rows), {})


def _model_steps(around: TargetSurroundings, view: View, stride: int) -> FloatArray:
    """Return the states (A, T, 4) of the view's agents at model steps; NaN for absent ones."""
    states = np.full((len(view.ids), around.steps // stride, 4), np.nan)
    row_of = {name: row for row, name in enumerate(around.ids)}
    for row, name in enumerate(view.ids):
        if name in row_of:
            states[row] = around.states[row_of[name], stride::stride]
    return states


def _solution(
    begin_s: float,
    contact_s: float,
    trajectories: FloatArray,
    is_solution: BoolArray,
    effort_mps2: FloatArray,
) -> Solution:
    count = int(is_solution.sum())
    best = int(np.where(is_solution, effort_mps2, np.inf).argmin()) if count else -1
    return Solution(
        solvable=count > 0,
        begin_s=begin_s,
        contact_s=contact_s,
        states=trajectories[best] if count else None,
        effort_mps2=float(effort_mps2[best]) if count else float("nan"),
        tried=len(is_solution),
        free=count,
    )
