"""Windows: a stretch of history and the future that followed, the unit of training and of seed scenes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import BoolArray
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.log_reader import LogScene

MODEL_STEP_S = 0.5


@dataclass(frozen=True)
class Window:
    """A stretch of one scene; A agents seen in it, H instants of history, F of future, clock 0 = now.

    Attributes:
        scene: name of the log scene.
        location: name of its map.
        start: keyframe of the first instant of history, on the window's spacing.
        history: (A, H) states; the last instant is now, t = 0.
        future: (A, F) states from one step after now on.
        ego: row of the recording vehicle, which is there throughout.
        parked: (A,) agents that never move in the whole scene.
    """

    scene: str
    location: str
    start: int
    history: Tracks
    future: Tracks
    ego: int
    parked: BoolArray

    @property
    def name(self) -> str:
        """Unique name, such as "scene-0061@4"."""
        return f"{self.scene}@{self.start}"

    @property
    def present(self) -> BoolArray:
        """(A,) agents that are there now; the others have left before or come later."""
        return self.history.valid[:, -1]


def windows(
    scene: LogScene,
    history_s: float = 2.0,
    future_s: float = 6.0,
    stride_s: float = MODEL_STEP_S,
    dt_s: float = MODEL_STEP_S,
) -> Iterator[Window]:
    """Yield the windows of *scene* in order of time.

    A history of 2 s at 2 Hz has five instants (t = −2 … 0 s), a future of 6 s has twelve (0.5 … 6 s). Agents
    that are nowhere valid in a window are left out of it; windows in which the ego is missing are skipped.

    Args:
        scene: a drive at any spacing; resampled to *dt_s* where its own differs.
        history_s: length of the history, a multiple of *dt_s*; 0: only now.
        future_s: length of the future, a multiple of *dt_s*.
        stride_s: time between the starts of two windows, a multiple of *dt_s*.
        dt_s: spacing.

    Raises:
        ValueError: a length is negative or no multiple of *dt_s*, or the stride is zero.
    """
    back, ahead, stride = (_steps(value, dt_s) for value in (history_s, future_s, stride_s))
    if stride == 0:
        raise ValueError(f"stride_s={stride_s} must be positive")
    same = abs(scene.tracks.dt_s - dt_s) < 1e-9
    tracks = scene.tracks if same else resample(scene.tracks, dt_s)
    total = back + 1 + ahead
    for start in range(0, tracks.steps - total + 1, stride):
        span = tracks.window(start, start + total)
        if not span.valid[scene.ego].all():
            continue
        present = np.asarray(span.valid.any(axis=1))
        cut = span.rows(present)
        now_s = cut.t0_s + dt_s * back
        cut = cut.shifted(-now_s)
        yield Window(
            scene=scene.name,
            location=scene.location,
            start=start,
            history=cut.window(0, back + 1),
            future=cut.window(back + 1, total),
            ego=int(present[: scene.ego].sum()),
            parked=scene.parked[present],
        )


def _steps(seconds: float, dt_s: float) -> int:
    steps = round(seconds / dt_s) if dt_s > 0.0 else -1
    if steps < 0 or abs(steps * dt_s - seconds) > 1e-9:
        raise ValueError(f"{seconds} s is no multiple of dt_s={dt_s}")
    return steps
