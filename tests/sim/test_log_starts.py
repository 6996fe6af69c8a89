"""Which instants of a driving log become seed scenes, on a hand-made street."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError, SceneError
from advdiff_sumo.core.record import EndReason
from advdiff_sumo.core.resample import resample
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.metric_rows import episode_row
from advdiff_sumo.planners.planner_protocol import SumoDriver
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.run_episodes import RunOptions, check_together, left_out
from advdiff_sumo.sim.seed_scene import PlacedTraffic
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from tests.sim import nets
from tests.sim.scenes import episode

STEP_S, STEPS, WAITS_S, SPEED_MPS = 0.5, 41, 8.0, 8.0


class OneDrive:
    """A log of one drive: 8 s at rest, then 12 s at *speed_mps*, eastbound in the right lane of the street."""

    def __init__(self, speed_mps: float) -> None:
        times = STEP_S * np.arange(STEPS)
        speed = np.where(times > WAITS_S, speed_mps, 0.0)
        x = 20.0 + np.concatenate(([0.0], np.cumsum(speed[1:] * STEP_S)))
        self.tracks = Tracks(
            ids=("ego",),
            classes=np.array([AgentClass.CAR]),
            size_m=np.array([[4.5, 1.8]]),
            xy_m=np.stack((x, np.full(STEPS, -4.8)), -1)[None],
            yaw_rad=np.zeros((1, STEPS)),
            speed_mps=speed[None],
            valid=np.ones((1, STEPS), dtype=np.bool_),
            t0_s=0.0,
            dt_s=STEP_S,
        )

    def names(self) -> list[str]:
        return ["drive"]

    def read(self, name: str) -> LogScene:
        return LogScene(name, "street", self.tracks, 0, np.zeros(1, dtype=np.bool_), Path("street"))

    def scenes(self) -> Iterator[LogScene]:
        yield self.read("drive")


def source(street: Path, speed_mps: float, **scene: float) -> LoggedTraffic:
    options = SceneOptions.parse({"stride_s": 2.0, **scene})
    return LoggedTraffic(RoadMap.read(street), OneDrive(speed_mps), options, SimOptions(), SeedTree(0))


@pytest.mark.parametrize("step_s", [0.04, 0.1, 0.2, 0.3, 1.0])
def test_histories_are_at_model_steps_whatever_the_spacing_of_the_log(street: Path, step_s: float) -> None:
    """In a log with steps of 0.2 s, instants 0.4 s apart must not be taken for instants 0.5 s apart."""
    made = source(street, SPEED_MPS)
    drive = OneDrive(SPEED_MPS)
    drive.tracks = resample(drive.tracks, step_s)
    scenes = [scene for scene in replace(made, reader=drive).scenes() if scene.history.xy_m[0, 0, 0] > 30.0]
    assert scenes
    for scene in scenes:
        np.testing.assert_allclose(scene.history.times_s, [-2.0, -1.5, -1.0, -0.5, 0.0], atol=1e-9)
        moved = np.diff(scene.history.xy_m[0, :, 0])
        np.testing.assert_allclose(moved, 0.5 * SPEED_MPS, atol=0.01)


def test_starts_at_which_the_ego_stands_are_passed_over_and_counted(street: Path) -> None:
    """Starts are possible at 2, 4, …, 14 s (with 6 s of future); the ego stands up to 8 s."""
    logged = source(street, SPEED_MPS)
    assert [scene.name for scene in logged.scenes()] == ["drive-020", "drive-024", "drive-028"]
    assert logged.standing_starts() == 4


def test_what_a_run_or_sweep_says_of_standing_starts(street: Path) -> None:
    options = RunOptions.parse(
        {"net": str(street), "scenes": "drives", "scene": {"stride_s": 2.0, "min_speed_mps": 0.5}}
    )
    assert left_out(options, RoadMap.read(street), None, OneDrive(SPEED_MPS)) == [
        "4 starts of the log passed over, its ego is slower than 0.5 m/s there (drives)"
    ]
    assert left_out(options, RoadMap.read(street), None, None) == []


def test_a_log_without_a_history_is_refused_before_the_first_episode(street: Path) -> None:
    """Vehicles of a log are inserted in the model step before the start; SUMO's own traffic is present already."""
    of_log, of_sumo = {"net": str(street), "scenes": "drives"}, {"net": str(street)}
    for history_s in (0.0, 1e-8):  # whole multiples, of no step
        options = RunOptions.parse({**of_log, "sim": {"history_s": history_s}})
        with pytest.raises(
            ConfigError, match=r"^sim\.history_s = .*; set it to 0\.5 \(sim\.model_step_s\) or more$"
        ):
            check_together(options, SumoDriver("IDM"))
    check_together(RunOptions.parse({**of_log, "sim": {"history_s": 0.5}}), SumoDriver("IDM"))
    check_together(RunOptions.parse({**of_sumo, "sim": {"history_s": 0.0}}), SumoDriver("IDM"))


def test_one_step_of_history_is_enough_for_a_log(street: Path) -> None:
    made = replace(source(street, SPEED_MPS), sim=SimOptions.parse({"history_s": 0.5}))
    scene = next(iter(made.scenes()))
    record, _ = episode(scene, made.road, horizon_s=0.3, history_s=0.5).run()
    assert (record.end, record.failure, record.tracks.steps) == (EndReason.HORIZON, None, 4)


def test_standing_is_a_start_where_it_is_asked_for(street: Path) -> None:
    logged = source(street, SPEED_MPS, min_speed_mps=0.0)
    assert len(list(logged.scenes())) == 7
    assert logged.standing_starts() == 0


def test_a_log_whose_ego_never_moves_is_refused(street: Path) -> None:
    with pytest.raises(SceneError, match=r"lower scene\.min_speed_mps"):
        list(source(street, 0.0).scenes())


def cut(steps: int = STEPS, turned_rad: float = 0.0, aside_m: float = 0.0) -> OneDrive:
    """Return the first *steps* instants of the drive, turned and shifted to the left."""
    log = OneDrive(SPEED_MPS)
    tracks = log.tracks.window(0, steps)
    xy = tracks.xy_m + np.array((0.0, aside_m))
    log.tracks = replace(tracks, xy_m=xy, yaw_rad=tracks.yaw_rad + turned_rad)
    return log


def test_a_log_starts_late_where_it_cannot_start_earlier(street: Path) -> None:
    """With 6 s of future, starts are possible from 2 to 3 s of 9 s; the ego is misaligned with its lane there."""
    log = cut(19)
    first_m = log.tracks.xy_m[0, 0, 0]
    askew = log.tracks.times_s < 4.0
    along_m = first_m + SPEED_MPS * log.tracks.times_s
    log.tracks = replace(
        log.tracks,
        xy_m=np.stack((along_m, log.tracks.xy_m[0, :, 1]), -1)[None],
        yaw_rad=np.where(askew, 0.2, 0.0)[None],
        speed_mps=np.full((1, 19), SPEED_MPS),
    )
    logged = replace(source(street, SPEED_MPS), reader=log)
    starts = [(scene.name, scene.horizon_s) for scene in logged.scenes()]
    assert starts == [("drive-008", 5.0), ("drive-012", 3.0)]
    assert list(replace(logged, late=False).scenes()) == []


@pytest.mark.parametrize(
    ("log", "words"),
    [
        (
            cut(7),
            "it has 3.0 s at most, and 2 s before a start and 1.5 s after it are needed; give a longer log",
        ),
        (
            cut(turned_rad=0.2),
            "where one could start, the ego is askew in its lane (at 25 of 25 instants); give a log whose ego",
        ),
    ],
)
def test_why_a_log_gives_no_scene(street: Path, log: OneDrive, words: str) -> None:
    """Instants are possible from 2 s on to 14 s, every 0.5 s."""
    logged = LoggedTraffic(RoadMap.read(street), log, SceneOptions(), SimOptions(), SeedTree(0))
    assert list(logged.scenes()) == []
    assert words in logged.why_none()


def test_the_most_frequent_reason_comes_first(street: Path) -> None:
    """Of 12 s the ego is missing at 2 s; five of the possible starts from 2 to 6 s have that in the 2 s before."""
    log = cut(25, turned_rad=0.2)
    log.tracks.valid[0, 4] = False
    logged = LoggedTraffic(RoadMap.read(street), log, SceneOptions(), SimOptions(), SeedTree(0))
    askew, missing = (
        "the ego is askew in its lane (at 4 of 9",
        "the ego was not there all the time before (at 5 of 9",
    )
    assert logged.why_none().startswith(
        f"where one could start, {missing} instants), {askew} instants); give"
    )


class WithOneThatParks(OneDrive):
    """The same with another car, 10 m behind in the next lane, which drives 40 m in 5 s and then parks."""

    def __init__(self) -> None:
        super().__init__(SPEED_MPS)
        x = 10.0 + np.minimum(STEP_S * np.arange(STEPS), 5.0) * SPEED_MPS
        speed = np.where(STEP_S * np.arange(STEPS) < 5.0, SPEED_MPS, 0.0)
        ego = self.tracks
        self.tracks = Tracks(
            ids=("ego", "parks"),
            classes=np.repeat(ego.classes, 2),
            size_m=np.repeat(ego.size_m, 2, axis=0),
            xy_m=np.concatenate((ego.xy_m, np.stack((x, np.full(STEPS, -1.6)), -1)[None])),
            yaw_rad=np.zeros((2, STEPS)),
            speed_mps=np.concatenate((ego.speed_mps, speed[None])),
            valid=np.ones((2, STEPS), dtype=np.bool_),
            t0_s=0.0,
            dt_s=STEP_S,
        )

    def read(self, name: str) -> LogScene:
        return LogScene(name, "street", self.tracks, 0, np.zeros(2, dtype=np.bool_), Path("street"))


def test_a_vehicle_that_is_parked_from_the_start_on_stays_parked(street: Path) -> None:
    """At 2 s it drives, at 10 s it has parked."""
    options = SceneOptions.parse({"stride_s": 2.0, "min_speed_mps": 0.0})
    logged = LoggedTraffic(RoadMap.read(street), WithOneThatParks(), options, SimOptions(), SeedTree(0))
    driven = {}
    for scene in logged.scenes():
        assert isinstance(scene.start, PlacedTraffic)
        driven[scene.name] = bool(scene.start.drivable[scene.log.index["parks"]])
    assert driven["drive-004"]
    assert not driven["drive-020"]


@pytest.mark.parametrize("target", ["IDM", "lane_graph"])
def test_a_target_that_sumo_refuses_fails_with_its_seed_scene_for_a_record(
    street: Path, tmp_path: Path, target: str
) -> None:
    """The net has changed meanwhile: all its lanes are for buses, so that the ego, a car, has none."""
    scene = next(source(street, SPEED_MPS).scenes())
    edges = re.sub(r'(id="[A-Z]+"[^/]*)/', r'\1 allow="bus"/', nets.STREET[1])
    net = nets.build(tmp_path, nets.STREET[0], edges, name="buses")
    road = RoadMap.read(net)
    record, _ = episode(replace(scene, net=net), road, target).run()
    assert record.end == EndReason.FAILED
    assert record.failure is not None
    assert (record.failure.kind, record.failure.time_s) == ("not_inserted", 0.0)
    assert record.failure.message.startswith("no lane of")
    assert (record.tracks.steps, record.tracks.ids[record.target]) == (1, scene.target)
    np.testing.assert_array_equal(record.tracks.xy_m[:, 0], scene.history.xy_m[:, -1])
    assert episode_row(record, road)["failure_kind"] == "not_inserted"


@pytest.mark.parametrize("target", ["IDM", "lane_graph"])
def test_a_target_that_waits_in_vain_for_its_lane_fails_as_not_inserted(
    street: Path, tmp_path: Path, target: str
) -> None:
    """Its direction's lanes are for buses. It is put on a lane of the other direction, where SUMO refuses it."""
    scene = next(source(street, SPEED_MPS).scenes())
    edges = re.sub(r'(id="(?:WM|ME)"[^/]*)/', r'\1 allow="bus"/', nets.STREET[1])
    net = nets.build(tmp_path, nets.STREET[0], edges, name="buses")
    record, _ = episode(replace(scene, net=net), RoadMap.read(net), target).run()
    assert record.failure is not None
    assert (record.end, record.failure.kind) == (EndReason.FAILED, "not_inserted")
    assert "did not get into SUMO" in record.failure.message
