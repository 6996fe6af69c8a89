"""What is counted of an episode's background, on an episode made by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.record import Controller
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.worker_pool import in_processes
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult
from advdiff_sumo.experiments.bench.intervals import estimate
from advdiff_sumo.experiments.bench.likelihood import natural_nats
from advdiff_sumo.experiments.bench.samples import background_samples, collision_samples
from advdiff_sumo.experiments.bench.traces import (
    BackgroundTrace,
    _solvable,
    _trace,
    at_model_step,
    histograms,
    near_target,
)
from advdiff_sumo.experiments.bench.transfer import _samples
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.metrics.collision import collisions, target_collision
from advdiff_sumo.metrics.metric_rows import collision_rows, episode_row
from advdiff_sumo.sim.episode import Timing
from advdiff_sumo.sim.run_store import episode_tables
from advdiff_sumo.sweep.stored_episode import StoredEpisode
from tests.metrics.encounters import crossing, record_of, straight

STEPS = 41


def driving(
    speeds: list[float], starts: list[tuple[float, float]], classes: list[AgentClass] | None = None
) -> Tracks:
    """Return straight drives to the east at 10 Hz."""
    time = 0.1 * np.arange(STEPS)
    xy = np.array([[(x + v * t, y) for t in time] for v, (x, y) in zip(speeds, starts, strict=True)])
    count = len(speeds)
    return Tracks(
        ids=tuple(f"v{k}" for k in range(count)),
        classes=np.array([int(c) for c in classes or [AgentClass.CAR] * count], dtype=np.int64),
        size_m=np.tile((5.0, 2.0), (count, 1)),
        xy_m=xy,
        yaw_rad=np.zeros((count, STEPS)),
        speed_mps=np.tile(np.array(speeds)[:, None], STEPS),
        valid=np.ones((count, STEPS), dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.1,
    )


def test_who_is_near() -> None:
    """The target does not count, nor does a walker, nor who is 60 m away; one comes near on the way."""
    walker = [AgentClass.CAR, AgentClass.CAR, AgentClass.PEDESTRIAN, AgentClass.CAR, AgentClass.CAR]
    tracks = driving([0.0, 5.0, 0.0, 0.0, -5.0], [(0, 0), (0, 8), (3, 3), (61, 0), (70, 8)], walker)
    near = near_target(at_model_step(tracks), 0)
    assert near.shape == (5, 9)
    assert near[1].all()
    assert not near[[0, 2, 3]].any()
    assert near[4].tolist() == [False] * 5 + [True] * 4  # 70 − 5 t < √(60² − 8²) = 59.5 after 2.1 s


def test_histograms_by_hand() -> None:
    """One is 5 m/s faster than who is 21 m ahead of it: 4.2 s at first; the target is in nobody's way."""
    tracks = at_model_step(driving([0.0, 10.0, 5.0], [(20, 9), (0, 0), (26, 0)]))
    near = near_target(tracks, 0)
    speed, accel, ttc = histograms(tracks, near)
    assert speed[10] == speed[20] == 9  # bins of 0.5 m/s
    assert sum(speed) == 18
    assert sum(accel) == 16
    assert accel[40] == 16  # no acceleration: the bin from 0 on
    assert sum(ttc) == 18
    assert ttc[8] == 2  # 4.2 s, of both
    assert ttc[-1] == 0


def test_who_heads_for_the_target_meets_it() -> None:
    """With 10 m/s and 38 m between the boxes it is 3.8 s away at first, and 0.5 s less each time, of nine."""
    tracks = at_model_step(driving([0.0, 10.0], [(43, 0), (0, 0)]))
    _, _, ttc = histograms(tracks, near_target(tracks, 0))
    assert ttc[:8] == (2, 1, 1, 1, 1, 1, 1, 1)  # at 4 s the boxes overlap: 0 s
    assert sum(ttc) == 9


def test_a_trace_survives_being_stored() -> None:
    trace = BackgroundTrace(3, 1, None, (1, 2), (3,), (4, 5), -7.25, 12.5, True)
    assert BackgroundTrace.from_bytes(trace.to_bytes()) == trace


def test_solvable_is_asked_of_the_contact_that_counts(tmp_path: Path) -> None:
    """Its middle is off the road from y = -6.4 on: that counts, and whom it hits later is not asked about."""
    road = crossing(tmp_path, "priority")
    still = straight("still", (-120.5, -11.0), 0.0, 0.0)
    record = record_of(straight("ego", (-150, -4.8), -0.2, 10.0), still)
    assert target_collision(record, collisions(record)) is not None
    row = episode_row(record, road)
    assert (row["target_collision"], row["collision_partner"]) == (True, None)
    tables = episode_tables(record, row, collision_rows(record, road), Timing(1.0, (), ()))
    assert _solvable(StoredEpisode(tables, None), road) is None


def test_who_hits_another_one_and_leaves_the_road_counts_once(tmp_path: Path) -> None:
    """One stands beside the road, another one leaves the road into it, a third does neither: two of three."""
    road = crossing(tmp_path, "priority")
    ego = straight("ego", (-150, -1.6), 0.0, 0.0)
    still = straight("still", (-90.0, -9.0), 0.0, 0.0)
    leaving = straight("leaving", (-110.0, -4.8), 0.0, 5.0, drift=-1.0)
    record = record_of(ego, still, leaving, straight("other", (-150, 4.8), np.pi, 5.0))
    record.controller[0] = Controller.PLANNER
    tables = episode_tables(
        record, episode_row(record, road), collision_rows(record, road), Timing(1.0, (), ())
    )
    trace = BackgroundTrace.from_bytes(_trace(StoredEpisode(tables, None), road, with_likelihood=False))
    assert (trace.vehicles, trace.hit, trace.off_road, trace.both) == (3, 2, 1, 1)
    rate = estimate(_samples("IDM", [seen("a", False, trace)])["IDM:bv_rate"])
    assert (rate.value, rate.n) == (pytest.approx(2 / 3), 3)


def seen(scene: str, hit: bool, trace: BackgroundTrace, **row: object) -> EpisodeResult:
    usual: dict[str, object] = {
        "target_collision": hit,
        "relative_speed_mps": 6.0 if hit else None,
        "accel_max_mps2": 3.0,
        "jerk_max_mps3": None,
        "at_fault": "target" if hit else None,
        "collision_partner": "v1" if hit else None,
        "attacker_visible": None,
    }
    return EpisodeResult(scene, {**usual, **row}, trace, 0.05)


def test_columns_of_the_closed_loop() -> None:
    bins = (1,) * 80, (1,) * 80, (1,) * 21
    moved = BackgroundTrace(4, 2, 1, *bins, -20.0, 10.0, False)
    natural = BackgroundTrace(5, 0, None, *bins, -5.0, 10.0)
    episodes = [
        seen("a", True, moved, attacker_visible=False),
        seen("b", True, moved, at_fault="other"),
        seen("c", False, moved),
        seen("d", False, moved),
    ]
    samples = collision_samples(episodes) | background_samples(episodes, [seen("a", False, natural)])
    found = {name: estimate(sample) for name, sample in samples.items()}
    assert (found["collision_rate"].value, found["collision_rate"].n) == (0.5, 4)
    assert (found["collision_mps"].value, found["collision_mps"].n) == (6.0, 2)
    assert (found["fault_rate"].value, found["seen_rate"].value) == (0.5, 0.5)
    assert (found["solvable_rate"].value, found["solvable_rate"].n) == (0.0, 2)
    assert found["jerk_mps3"].value is None
    assert (found["veh_rate"].value, found["veh_rate"].n) == (0.5, 16)
    assert found["env_rate"].value == 0.25
    assert found["nats"].value == pytest.approx(-2.0)
    assert (found["jsd"].value, samples["jsd"].scenes) == (0.0, ("a",))  # only scenes that both have
    assert found["hz"].value == pytest.approx(20.0)


def test_nobody_moved_has_no_rate_of_leaving_the_road() -> None:
    natural = BackgroundTrace(5, 0, None, (1,), (1,), (1,), -5.0, 10.0)
    assert "env_rate" not in background_samples([seen("a", False, natural)], ())


class Motorway:
    """A target and who drives 40 m behind it, along the longest lane of the shipped motorway for 8 s at 12 m/s."""

    def __init__(self) -> None:
        self.road = RoadMap.read(find_net("motorway"))
        lane = max(
            (one for one in self.road.lanes.values() if not one.is_internal), key=lambda one: one.length_m
        )
        self.start, end = lane.centre_xy_m[0], lane.centre_xy_m[-1]
        self.ahead = (end - self.start) / np.linalg.norm(end - self.start)
        self.along = np.arange(17)[:, None] * 0.5 * 12.0 * self.ahead
        self.there = np.ones((2, 17), dtype=np.bool_)

    def nats(self, path: np.ndarray, valid: np.ndarray) -> tuple[float, float]:
        """Return the bound of who drives *path* (17, 2), from the lane's beginning, and the seconds that it is of."""
        tracks = Tracks(
            ids=("target", "other"),
            classes=np.zeros(2, dtype=np.int64),
            size_m=np.tile((4.5, 1.8), (2, 1)),
            xy_m=np.stack((self.start + 40.0 * self.ahead + self.along, self.start + path)),
            yaw_rad=np.full((2, 17), np.arctan2(self.ahead[1], self.ahead[0])),
            speed_mps=np.full((2, 17), 12.0),
            valid=valid,
            t0_s=0.0,
            dt_s=0.5,
        )
        return natural_nats(self.road, tracks, 0, np.array([False, True]))


def test_vehicles_of_sumo_are_not_those_of_a_policy_that_moved_nobody() -> None:
    """It moved four in one episode, one of whom hit another: of four. Of SUMO itself all nine count."""
    bins = (1,), (1,), (1,)
    episodes = [
        seen("a", False, BackgroundTrace(4, 1, 0, *bins, 0.0, 0.0)),
        seen("b", False, BackgroundTrace(5, 2, None, *bins, 0.0, 0.0)),
    ]
    own = {name: estimate(sample) for name, sample in background_samples(episodes, ()).items()}
    assert (own["veh_rate"].value, own["veh_rate"].n) == (0.25, 4)
    assert (own["env_rate"].value, own["env_rate"].n) == (0.0, 4)
    natural = estimate(background_samples(episodes, (), plans=False)["veh_rate"])
    assert (natural.value, natural.n) == (pytest.approx(3 / 9), 9)
    assert estimate(background_samples(episodes[1:], ())["veh_rate"]).value is None


def test_who_drives_along_the_road_is_likelier_than_who_does_not() -> None:
    """On the shipped motorway a steady drive along a lane has a higher bound than one that goes sideways."""
    motorway = Motorway()
    side = np.array([-motorway.ahead[1], motorway.ahead[0]])
    astray = motorway.along + (np.maximum(np.arange(17) - 4, 0) ** 2)[:, None] * 0.2 * side
    nats, seconds = motorway.nats(motorway.along, motorway.there)
    assert seconds == 12.0  # windows at 2, 4 and 6 s with 12, 8 and 4 instants of future
    assert nats > motorway.nats(astray, motorway.there)[0]


def test_where_the_record_ends_costs_no_likelihood() -> None:
    """An instant adds at most log(1 / (2π · 0.5²)) = -0.45: what is known of fewer instants is no less likely.

    The target leaves after 2 s, so that there is one window.
    """
    motorway, nats = Motorway(), []
    for known in (12, 11, 10, 8, 6, 4, 2):
        there = motorway.there.copy()
        there[0, 5:] = there[1, 5 + known :] = False
        bound, seconds = motorway.nats(motorway.along, there)
        assert seconds == 0.5 * known
        nats.append(bound)
    assert nats == sorted(nats)
    assert nats[-1] - nats[0] < 10.0


def test_work_in_processes_comes_back_by_its_key() -> None:
    assert dict(in_processes({"a": (divmod, 7, 2), "b": (divmod, 9, 4)}, 1)) == {"a": (3, 1), "b": (2, 1)}
