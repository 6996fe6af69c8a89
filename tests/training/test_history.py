"""Events of a training that was left and taken up again."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.cli.terminal import terminal
from advdiff_sumo.cli.train import _train_with_progress
from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.training import history
from tests.training.test_training_loop import job, run


def test_events_after_the_checkpoint_are_hidden_from_tensorboard(tmp_path: Path) -> None:
    """Left after step 2 with a checkpoint, and killed after step 4 without one: step 3 comes again."""
    pytest.importorskip("tensorboard", reason="needs the extra train: pip install 'advdiff-sumo[train]'")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    for done, figures in ((0, (1.0, 2.0, 3.0, 4.0)), (2, (30.0,))):
        events = history.open_events(tmp_path, done)
        assert events is not None
        for k, value in enumerate(figures):
            events.add_scalar("step/loss", value, done + 1 + k)
        events.close()
    shown = EventAccumulator(str(tmp_path)).Reload().Scalars("step/loss")
    assert [(one.step, one.value) for one in shown] == [(1, 1.0), (2, 2.0), (3, 30.0)]


def test_a_training_that_goes_on_opens_its_events_at_its_checkpoint(
    window_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[tuple[Path, int]] = []
    monkeypatch.setattr(history, "open_events", lambda folder, step: opened.append((folder, step)))
    out = tmp_path / "out"
    with pytest.raises(WeightsError, match="no such checkpoint"):
        _train_with_progress(job(window_folder, out), True, terminal(stderr=True))
    assert opened == []
    run(job(window_folder, out), stop_after=2)
    assert _train_with_progress(job(window_folder, out), True, terminal(stderr=True))
    assert opened == [(out / "events", 2)]
