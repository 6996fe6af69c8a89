"""Windows: cut by hand, and over the real drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.data.nuscenes import NuScenesReader
from advdiff_sumo.data.windows import windows


def scene(steps: int, dt_s: float = 0.5) -> LogScene:
    """Return a drive of the ego (row 1), an early leaver and a late comer."""
    valid = np.ones((3, steps), dtype=np.bool_)
    valid[0, 3:] = False
    valid[2, : steps - 1] = False
    x = np.where(valid, np.arange(steps) * 1.0, np.nan)
    tracks = Tracks(
        ids=("early", "ego", "late"),
        classes=np.zeros(3, dtype=np.int64),
        size_m=np.tile([4.5, 1.8], (3, 1)),
        xy_m=np.stack((x, 0 * x), axis=-1),
        yaw_rad=0 * x,
        speed_mps=0 * x + 2.0,
        valid=valid,
        t0_s=0.0,
        dt_s=dt_s,
    )
    return LogScene("drive", "town", tracks, 1, np.array([True, False, False]), Path("log"))


def test_two_seconds_of_history_and_six_of_future() -> None:
    found = list(windows(scene(20)))
    assert [w.name for w in found] == ["drive@0", "drive@1", "drive@2", "drive@3"]
    first, last = found[0], found[-1]
    assert (first.history.steps, first.future.steps) == (5, 12)
    np.testing.assert_allclose(first.history.times_s, [-2.0, -1.5, -1.0, -0.5, 0.0])
    assert (first.future.t0_s, first.future.times_s[-1]) == (0.5, 6.0)
    assert first.history.ids == first.future.ids == ("early", "ego")
    assert first.present.tolist() == [False, True]
    assert (first.ego, last.ego) == (1, 0)
    assert last.history.ids == ("ego", "late")
    assert (first.parked.tolist(), last.parked.tolist()) == ([True, False], [False, False])
    assert last.history.xy_m[last.ego, 0, 0] == 3.0


def test_the_stride_and_lengths_are_free() -> None:
    assert [w.start for w in windows(scene(20), 0.0, 1.0, stride_s=4.0)] == [0, 8, 16]
    assert list(windows(scene(16))) == []
    assert len(list(windows(scene(17)))) == 1


def test_windows_without_the_ego_are_skipped() -> None:
    log = scene(20)
    log.tracks.valid[1, 0] = False
    assert [w.start for w in windows(log)] == [1, 2, 3]


@pytest.mark.parametrize("bad", [{"history_s": 0.7}, {"future_s": -1.0}, {"stride_s": 0.0}, {"dt_s": 0.0}])
def test_lengths_that_do_not_fit_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"s"):
        list(windows(scene(20), **bad))


@pytest.mark.data
def test_real_drives_give_every_window(adv_data: Path) -> None:
    count = 0
    for log in NuScenesReader(adv_data / "nuscenes-mini").scenes():
        found = list(windows(log))
        assert len(found) == log.tracks.steps - 16
        for window in found:
            joined = np.concatenate((window.history.xy_m, window.future.xy_m), axis=1)
            rows = [log.tracks.index[name] for name in window.history.ids]
            np.testing.assert_array_equal(joined, log.tracks.xy_m[rows, window.start : window.start + 17])
            assert window.history.ids[window.ego] == "ego"
        count += len(found)
    assert count == 195
