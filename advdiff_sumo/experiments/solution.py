"""Whether a collision could have been avoided: Strive's solution stage.

After Rempe et al. 2022 (Sec. 3.3, doi:10.1109/CVPR52688.2022.01679): a scenario is solvable when, with everybody
else as recorded, another drive of the target exists that touches nobody and stays on the road. Theirs searches
the target's latent; this one searches its actions, from draws of the traffic model and from plain manoeuvres, tries
to brake on the recorded way, and checks all of it with the exact boxes at the simulation's step. Others do not react,
so a drive that they would have made room for does not count: the share of solvable scenarios is a lower bound. As in
the verdict, it is no matter if a third runs into the target's rear, who would have to keep its distance.
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
"""The search begins so long before the collision, and ends so long after it."""


class SolveOptions(Options):
    """How to look for a solution.

    Attributes:
        draws: futures of the traffic model to start from, beside the plain manoeuvres.
        rounds: steps of Adam from every start.
        seed: of the draws.
        weights: a bundle of networks; empty: the shipped one.
        device: as of the background policies.
    """

    draws: int = Field(6, ge=1, le=256)
    rounds: int = Field(60, ge=0, le=10000)
    seed: int = Field(0, ge=0)
    weights: str = ""
    device: str = "auto"


@dataclass(frozen=True)
class Solution:
    """What was found.

    Attributes:
        solvable: whether a drive was found.
        begin_s: when it leaves the recorded one.
        contact_s: when the recorded one collides, since the episode's start.
        states: (T + 1, 4) x, y, yaw, speed of the target at the record's step from ``begin_s`` on, the mildest
            drive found; None where none was.
        effort_mps2: root mean square of its acceleration, across and along; NaN where there is none.
        tried: drives that were looked at.
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
    """Return whether the target of *episode*, which ended in a collision, could have driven otherwise.

    The target is given ``BEFORE_S`` to do something about it; whoever is no longer recorded afterwards
    keeps its velocity for ``AFTER_S``.

    Args:
        episode: its states.
        road: its net.
        options: how long to look.
        contact: the instant from which on boxes overlap; None: that where boxes first meet, or else, as contact may
            fall between two instants, the last.

    Raises:
        WeightsError: the networks are missing or unusable.
        ConfigError: no such device.
    """
    options = options or SolveOptions()
    tracks = episode.tracks
    contact = first_contact(tracks, episode.target) if contact is None else contact
    stride = max(round(MODEL_STEP_S / tracks.dt_s), 1)
    absent = np.flatnonzero(~tracks.valid[episode.target, :contact])
    earliest = int(absent[-1]) + 1 if absent.size else 0
    begin = max(contact - round(BEFORE_S / tracks.dt_s), earliest)
    needed = (contact - begin) * tracks.dt_s + AFTER_S
    steps = min(int(np.ceil(needed / MODEL_STEP_S - 1e-9)), FUTURE_STEPS)
    around = surroundings(tracks, episode.target, begin, steps * stride)
    given = BaselineOptions(weights=options.weights, device=options.device)
    prior = prior_of(given, "the solution stage")
    view = look(road, _scene(tracks, episode.target, begin, stride), map_view=prior.map_view)
    others = _model_steps(around, view, stride)
    searched = search(prior, view, others, steps, options.draws, options.rounds, options.seed)
    slower = braked(tracks, episode.target, begin, steps, tracks.dt_s * stride)
    accel = np.concatenate((searched.accel_mps2, slower[0]))
    curvature = np.concatenate((searched.curvature_1pm, slower[1]))
    driven = drive(around, accel, curvature, stride)
    free = usable(road, around, driven, met_by(tracks, episode.target, contact))
    across = curvature * driven[:, stride::stride, 3] ** 2
    effort = np.sqrt((accel**2 + across**2).mean(axis=1))
    return _solution(begin * tracks.dt_s, contact * tracks.dt_s, driven, free, effort)


def first_contact(tracks: Tracks, target: int) -> int:
    """Return the first instant at which the box of *target* overlaps another; the last one it is there otherwise."""
    touched = np.flatnonzero((_gaps(tracks, target) < 0.0).any(axis=0))
    return int(touched[0]) if len(touched) else int(np.flatnonzero(tracks.valid[target])[-1])


def met_by(tracks: Tracks, target: int, contact: int) -> frozenset[str]:
    """Return the ids of those whose boxes *target* overlaps by the instant *contact*, and of who is nearest then."""
    gaps = _gaps(tracks, target)[:, : contact + 1]
    rows = {int(np.argmin(gaps[:, -1])), *np.flatnonzero((gaps < 0.0).any(axis=1)).tolist()}
    return frozenset(tracks.ids[row] for row in rows)


def _gaps(tracks: Tracks, target: int) -> FloatArray:
    """Return (A, T) signed gaps of all boxes to that of *target*; inf to itself and of who is not there."""
    boxes = corners(tracks.xy_m, tracks.yaw_rad, np.repeat(tracks.size_m[:, None], tracks.steps, axis=1))
    with np.errstate(invalid="ignore"):
        gaps = separation(boxes, np.broadcast_to(boxes[target], boxes.shape))
    gaps[target] = np.inf
    return np.where(np.isnan(gaps), np.inf, gaps)


def _scene(tracks: Tracks, target: int, begin: int, stride: int) -> Scene:
    """Return the instant *begin* with its past at model steps; what was not recorded is unknown."""
    here = np.flatnonzero(tracks.valid[:, begin])
    index = begin - stride * np.arange(HISTORY_STEPS - 1, -1, -1)
    known, index = index >= 0, np.maximum(index, 0)
    t0_s = tracks.t0_s + tracks.dt_s * (begin - stride * (HISTORY_STEPS - 1))
    history = tracks.rows(here).at(index, t0_s, tracks.dt_s * stride)
    history = history.where(history.valid & known)
    row = int(np.flatnonzero(here == target)[0])
    movable = np.arange(len(here)) != row
    return Scene(history, row, movable, ((),) * len(here), {})


def _model_steps(around: TargetSurroundings, view: View, stride: int) -> FloatArray:
    """Return (A, T, 4) what the view's agents do at model steps; NaN for who is not there."""
    out = np.full((len(view.ids), around.steps // stride, 4), np.nan)
    index = {name: row for row, name in enumerate(around.ids)}
    for row, name in enumerate(view.ids):
        if name in index:
            out[row] = around.states[index[name], stride::stride]
    return out


def _solution(
    begin_s: float, contact_s: float, driven: FloatArray, free: BoolArray, effort: FloatArray
) -> Solution:
    count = int(free.sum())
    best = int(np.where(free, effort, np.inf).argmin()) if count else -1
    return Solution(
        solvable=count > 0,
        begin_s=begin_s,
        contact_s=contact_s,
        states=driven[best] if count else None,
        effort_mps2=float(effort[best]) if count else float("nan"),
        tried=len(free),
        free=count,
    )
