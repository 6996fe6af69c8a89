"""Background that follows the log, whatever the target does."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from advdiff_sumo.config import Options
from advdiff_sumo.core.errors import SceneError
from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import Scene, Tracks

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap

_ALIGNED_STEPS = 1e-6
"""An instant this near to one of the log, in steps, needs no resampling."""


class ReplayOptions(Options):
    """Options of ``replay``.

    Attributes:
        step_s: spacing of the plan, the simulation's step.
        period_s: duration of each plan; at least the time between two plans.
        max_gap_s: longest gap in a logged track that is filled in; a longer one takes the vehicle away.
    """

    step_s: float = Field(default=0.1, gt=0.0, le=1.0)
    period_s: float = Field(default=1.0, gt=0.0, le=60.0)
    max_gap_s: float = Field(default=1.0, ge=0.0, le=10.0)


class Replay:
    """Moves every logged agent but the target along its log; the memory is the log at the simulation's step.

    Vehicles that enter later are part of the plan and become valid when they enter. A logged vehicle of the scene
    whose log has ended stays in the plan without a valid instant, so it leaves.
    """

    Options: ClassVar[type[ReplayOptions]] = ReplayOptions
    everywhere: ClassVar[bool] = True  # a log does not end at the control radius

    def __init__(self, **options: float) -> None:
        """Take the options of :class:`ReplayOptions`.

        Raises:
            ConfigError: an option has no such name or value.
        """
        self.options = ReplayOptions.parse(options, "options of background 'replay'")

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Tracks:  # noqa: ARG002 - the contract
        """Return *log* from now on at every ``step_s``.

        Raises:
            SceneError: there is no log.
        """
        if log is None:
            raise SceneError(
                "background 'replay' needs a log, and the seed scene has none; use 'sumo' or --scenes"
            )
        ahead = resample(log, self.options.step_s, t0_s=scene.time_s, max_gap_s=self.options.max_gap_s)
        return _without_single_instants(ahead)

    def plan(
        self,
        road: RoadMap,  # noqa: ARG002 - the contract
        scene: Scene,
        memory: Tracks,
        rng: np.random.Generator,  # noqa: ARG002 - the contract
    ) -> tuple[JointPlan, Tracks]:
        """Return the log from now on for ``period_s``; the memory does not change."""
        step = self.options.step_s
        steps = max(1, round(self.options.period_s / step))
        log = _cut(memory, scene.time_s + step, steps)
        movable = {
            name for name, is_movable in zip(scene.history.ids, scene.movable, strict=True) if is_movable
        }
        fixed = set(scene.history.ids) - movable | {scene.target_id}
        rows = [
            row
            for row, name in enumerate(log.ids)
            if name not in fixed and (name in movable or log.valid[row].any())
        ]
        return JointPlan(log.rows(np.array(rows, dtype=np.int64)), exact=True), memory


def _cut(tracks: Tracks, t0_s: float, steps: int) -> Tracks:
    """Return *steps* instants from *t0_s* on, invalid beyond the ends of *tracks*."""
    offset = (t0_s - tracks.t0_s) / tracks.dt_s
    first = round(offset)
    if abs(offset - first) > _ALIGNED_STEPS:
        return resample(tracks, tracks.dt_s, t0_s=t0_s, steps=steps)
    start, stop = np.clip([first, first + steps], 0, tracks.steps)
    before = min(max(-first, 0), steps)
    part = tracks.window(int(start), int(stop)).padded(before, steps - before - int(stop - start))
    return replace(part, t0_s=t0_s)


def _without_single_instants(tracks: Tracks) -> Tracks:
    """Return *tracks* without valid stretches of one instant, along which a vehicle cannot be driven."""
    absent = np.zeros((tracks.agents, 1), dtype=np.bool_)
    before, after = np.hstack((absent, tracks.valid[:, :-1])), np.hstack((tracks.valid[:, 1:], absent))
    return tracks.where(before | after)
