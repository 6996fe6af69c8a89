"""Move road users of a log that neither SUMO nor the policy can drive: parked, on foot, off the lanes, or entering."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.sim.background_control import Background, MovedMotion
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SimOptions

_MAX_GAP_S = 1.0  # gaps of a log that are interpolated


class EpisodeContext:
    """Moves these road users as in the log; there are none in scenes from SUMO traffic."""

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
        """Return the motion of all road users from *sim*'s history up to instant 0."""
        first_step = round((-sim.history_s - self._log.t0_s) / self.step_s) + 1
        motion = self._motion(np.arange(self._log.agents), first_step, round(sim.history_s / self.step_s))
        self.entered.update(self._log.ids[k] for k in np.flatnonzero(motion.valid.any(axis=1)))
        return motion

    def motion(self, scene: Scene, steps: int) -> MovedMotion:
        """Return the log's motion in the coming *steps* of road users that are not driven otherwise."""
        if not isinstance(self.scene.start, PlacedTraffic):
            return MovedMotion.none(steps)
        log = self._log
        first_step = round((scene.time_s - log.t0_s) / self.step_s) + 1
        appears_soon: BoolArray = np.asarray(log.valid[:, first_step : first_step + steps].any(axis=1))
        agents = []
        for k, name in enumerate(log.ids):
            is_entering = appears_soon[k] and name not in self.entered
            if name != scene.target_id and (name not in self._drivable or is_entering):
                if appears_soon[k] or self.world.row_of(name) is not None:
                    agents.append(k)
                if is_entering:
                    self.entered.add(name)
        return self._motion(np.asarray(agents, dtype=np.int64), first_step, steps)

    def rows(self) -> IntArray:
        """Return the world's rows that follow the log throughout."""
        if not isinstance(self.scene.start, PlacedTraffic):
            return np.zeros(0, dtype=np.int64)
        names = (name for name in self.scene.log.ids if name not in self._drivable)
        rows = (self.world.row_of(name) for name in names)
        return np.array([row for row in rows if row is not None], dtype=np.int64)

    def _motion(self, agents: IntArray, first: int, steps: int) -> MovedMotion:
        """Return the motion of *agents* in *steps* steps of the log from step *first* on."""
        log = self._log
        span = slice(first, min(first + steps, log.steps))
        valid = np.zeros((len(agents), steps), dtype=np.bool_)  # all leave at the log's end
        valid[:, : span.stop - span.start] = log.valid[agents, span]
        xy, yaw, speed = (
            _extended(part[agents, span], steps) for part in (log.xy_m, log.yaw_rad, log.speed_mps)
        )
        rows = np.array([self.background.row_for(log, int(k)) for k in agents], dtype=np.int64)
        return MovedMotion(xy, yaw, speed, rows, valid)


def _extended(part: FloatArray, steps: int) -> FloatArray:
    """Return *part* (N, n, …) extended to *steps* instants with NaN."""
    extended = np.full((part.shape[0], steps, *part.shape[2:]), np.nan)
    extended[:, : part.shape[1]] = part
    return extended
