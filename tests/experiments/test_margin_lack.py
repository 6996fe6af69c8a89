"""What an episode lacked in which nobody could attack, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.experiments.margin_lack import lack_text

LONG = {"end": "horizon", "duration_s": 10.0}


def states(speed_mps: float, *others: tuple[float, float, float]) -> EpisodeStates:
    """Return two instants of a target that goes north from (0, 0), and of others (ahead, left, speed) like it."""
    cars = [(0.0, 0.0, speed_mps), *others]
    xy = np.array([[(-left, ahead + 0.1 * k * v) for k in range(2)] for ahead, left, v in cars])
    speed = np.array([[v, v] for _, _, v in cars])
    count = len(cars)
    tracks = Tracks(
        ids=tuple(f"v{k}" for k in range(count)),
        classes=np.full(count, int(AgentClass.CAR)),
        size_m=np.tile([4.6, 1.8], (count, 1)),
        xy_m=xy,
        yaw_rad=np.full((count, 2), np.pi / 2.0),
        speed_mps=speed,
        valid=np.ones((count, 2), dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.1,
    )
    return EpisodeStates(tracks, 0)


@pytest.mark.parametrize(
    ("attack", "episode", "told"),
    [
        ("crossing", states(0.2), "the target stood"),
        ("crossing", states(2.04), "the target drove at most 2.0 m/s"),
        ("crossing", states(9.0), "the record does not tell what was lacking"),
        (
            "hard-stop",
            states(0.0, (70.0, 0.0, 8.0), (-9.0, 0.0, 8.0)),
            "the target stood and nobody was straight ahead of it within 68 m",
        ),
        ("hard-stop", states(9.0, (30.0, 0.5, 4.0)), "who was ahead of it drove at most 4.0 m/s"),
        ("hard-stop", states(33.0, (60.0, 0.5, 4.0)), "who was ahead of it drove at most 4.0 m/s"),
        ("hard-stop", states(9.0, (30.0, 0.5, 6.0)), "the record does not tell what was lacking"),
        ("cut-out", states(9.0, (30.0, 3.2, 9.0)), "nobody was straight ahead of it within 68 m"),
        ("cut-in", states(9.0, (30.0, 0.0, 9.0)), "nobody drove beside it within 55 m"),
        ("cut-in", states(9.0, (60.0, 3.2, 9.0)), "nobody drove beside it within 55 m"),
        ("pull-out", states(9.0, (30.0, 0.0, 9.0)), "nobody drove beside it within 55 m"),
        ("pull-out", states(5.0, (30.0, 3.2, 0.0)), "the target drove at most 5.0 m/s"),
        ("cut-in", states(9.0, (30.0, 3.2, 9.0)), "the record does not tell what was lacking"),
    ],
)
def test_by_hand(attack: str, episode: EpisodeStates, told: str) -> None:
    assert lack_text(attack, LONG, episode) == told


@pytest.mark.parametrize(("end", "why"), [("horizon", "--horizon"), ("arrived", "arrived")])
def test_a_short_episode(end: str, why: str) -> None:
    row = {"end": end, "duration_s": 2.0}
    assert lack_text("crossing", row, states(9.0)) == f"the episode lasted 2.0 s ({why})"


def test_an_episode_that_may_be_too_short_is_told_where_nothing_else_lacked() -> None:
    row = {"end": "horizon", "duration_s": 8.0}
    assert (
        lack_text("hard-stop", row, states(9.0, (30.0, 0.5, 6.0))) == "the episode lasted 8.0 s (--horizon)"
    )
    assert lack_text("crossing", row, states(0.2)) == "the target stood"
