"""Logged road users that neither SUMO nor the policy can drive: parked, on foot, off the lanes, just entering."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.sim.background_control import Background, MovedMotion
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SimOptions

_MAX_GAP_S = 1.0


class EpisodeContext:
    """Follows the log for those agents; nobody in scenes that come from SUMO traffic."""

    def __init__(self, background: Background, scene: SeedScene) -> None:
        self.background, self.scene = background, scene
        self.world, self.step_s = background.world, background.step_s
        self.entered: set[str] = set()

    @cached_property
    def _log(self) -> Tracks:
        log = self.scene.log
        return resample(log, self.step_s, t0_s=log.t0_s, max_gap_s=_MAX_GAP_S)

    @cached_property
    def _drivable(self) -> frozenset[str]:
        if not isinstance(self.scene.start, PlacedTraffic):
            return frozenset()
        drivable = self.scene.start.drivable
        return frozenset(name for name, free in zip(self.scene.log.ids, drivable, strict=True) if free)

    def history(self, sim: SimOptions) -> MovedMotion:
        """Return everybody's motion from the log's beginning up to instant 0."""
        first = round((-sim.history_s - self._log.t0_s) / self.step_s) + 1
        motion = self._motion(np.arange(self._log.agents), first, round(sim.history_s / self.step_s))
        self.entered.update(self._log.ids[k] for k in np.flatnonzero(motion.valid.any(axis=1)))
        return motion

    def motion(self, scene: Scene, steps: int) -> MovedMotion:
        """Return what the log does in the coming *steps* with those that nobody else drives."""
        if not isinstance(self.scene.start, PlacedTraffic):
            return MovedMotion.none(steps)
        log = self._log
        first = round((scene.time_s - log.t0_s) / self.step_s) + 1
        soon: BoolArray = np.asarray(log.valid[:, first : first + steps].any(axis=1))
        picked = []
        for k, name in enumerate(log.ids):
            entering = soon[k] and name not in self.entered
            if name != scene.target_id and (name not in self._drivable or entering):
                if soon[k] or self.world.row_of(name) is not None:
                    picked.append(k)
                if entering:
                    self.entered.add(name)
        return self._motion(np.asarray(picked, dtype=np.int64), first, steps)

    def rows(self) -> IntArray:
        """Return the world's rows that follow the log throughout."""
        if not isinstance(self.scene.start, PlacedTraffic):
            return np.zeros(0, dtype=np.int64)
        names = (name for name in self.scene.log.ids if name not in self._drivable)
        rows = (self.world.row_of(name) for name in names)
        return np.array([row for row in rows if row is not None], dtype=np.int64)

    def _motion(self, agents: IntArray, first: int, steps: int) -> MovedMotion:
        log = self._log
        cut = slice(first, min(first + steps, log.steps))
        valid = np.zeros((len(agents), steps), dtype=np.bool_)  # beyond the log's end everybody leaves
        valid[:, : cut.stop - cut.start] = log.valid[agents, cut]
        xy, yaw, speed = (
            _filled(part[agents, cut], steps) for part in (log.xy_m, log.yaw_rad, log.speed_mps)
        )
        rows = np.array([self.background.row_for(log, int(k)) for k in agents], dtype=np.int64)
        return MovedMotion(xy, yaw, speed, rows, valid)


def _filled(part: FloatArray, steps: int) -> FloatArray:
    """Return *part* (N, n, …) with NaN up to *steps* instants."""
    full = np.full((part.shape[0], steps, *part.shape[2:]), np.nan)
    full[:, : part.shape[1]] = part
    return full
