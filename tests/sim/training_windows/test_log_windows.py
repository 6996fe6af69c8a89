"""Windows from driving logs."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import ConfigError, LogError, SceneError
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data import LogReader, LogScene, NuScenesReader, ScenarioNetReader
from advdiff_sumo.data.window_files import read_windows
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.training_windows.log_nets import LogNets
from advdiff_sumo.sim.training_windows.log_windows import BuildOptions, Built, build, log_windows
from tests.sim.records_made import record, write


def drive(dt_s: float = 0.5) -> LogScene:
    """Return 10 s on the street of the tests: the ego at 10 m/s, a car ahead of it, a parked one, a pedestrian."""
    steps = round(10.0 / dt_s) + 1
    t = dt_s * np.arange(steps)
    xy = np.zeros((4, steps, 2))
    xy[0, :, 0], xy[1, :, 0], xy[2], xy[3, :, 0] = 20 + 10 * t, 100 + 12 * t, (60.0, -8.0), 40 + t
    xy[[0, 1], :, 1], xy[3, :, 1] = -4.8, -9.0
    speed = np.repeat([[10.0], [12.0], [0.0], [1.0]], steps, axis=1)
    full = np.ones((4, steps), dtype=np.bool_)
    size = np.array([[4.0, 1.8], [4.5, 1.8], [4.2, 1.7], [0.7, 0.7]])
    tracks = Tracks(
        ("ego", "ahead", "still", "foot"),
        np.array([0, 0, 0, 5]),
        size,
        xy,
        0.0 * t + np.zeros((4, 1)),
        speed,
        full,
        0.0,
        dt_s,
    )
    return LogScene("scene-0061", "street", tracks, 0, np.array([False, False, True, False]), Path("log"))


@pytest.fixture(scope="module")
def road(street: Path) -> RoadMap:
    return RoadMap.read(street)


def test_every_instant_with_whole_past_and_future_around_ego_and_moving_cars(road: RoadMap) -> None:
    made = list(log_windows(drive(), road, BuildOptions()))
    # 21 instants: now is 2, 2.5 … 4 s; "ahead" is 84 m away or more and gets a window of its own
    assert len(made) == 2 * 5
    first, second = made[:2]
    np.testing.assert_allclose(first.past[0, -1], [40.0, -4.8, 0.0, 10.0])
    np.testing.assert_allclose(second.past[0, -1], [124.0, -4.8, 0.0, 12.0])
    assert first.parked.tolist() == [False, False, True]  # ego, then the walker, then the parked car
    assert first.future_valid.all()
    assert len(list(log_windows(drive(), road, BuildOptions(others=False, stride_s=1.0)))) == 3


def test_other_spacings_give_the_same_windows(road: RoadMap) -> None:
    coarse, fine = (list(log_windows(drive(dt), road, BuildOptions())) for dt in (0.5, 0.1))
    assert len(coarse) == len(fine)
    for a, b in zip(coarse, fine, strict=True):
        np.testing.assert_allclose(a.past, b.past, atol=1e-9)
        np.testing.assert_allclose(a.future, b.future, atol=1e-9)


def test_given_windows_and_no_others(road: RoadMap) -> None:
    made = list(log_windows(drive(), road, BuildOptions(), [(20, "still"), (3, "ahead"), (3, "nobody")]))
    assert len(made) == 2
    assert not made[0].future_valid.any()  # the drive ends
    assert made[1].past_valid[0].tolist() == [False, True, True, True, True]


class OneDrive:
    """A log of one drive."""

    def __init__(self, scene: LogScene) -> None:
        self.scene = scene

    def names(self) -> list[str]:
        return [self.scene.name]

    def read(self, name: str) -> LogScene:
        return self.scene

    def scenes(self) -> list[LogScene]:  # type: ignore[override] # any iterable will do
        return [self.scene]


def built(reader: LogReader, nets: LogNets, out: Path, options: BuildOptions | None = None) -> Built:
    return build([(Path("log"), reader)], nets, options or BuildOptions(), out, lambda *_: None)


def test_a_file_of_windows_of_the_net_that_fits(road: RoadMap, crossing: Path, tmp_path: Path) -> None:
    nets = LogNets((RoadMap.read(crossing), road), None)
    found = built(OneDrive(drive()), nets, tmp_path / "w.safetensors")
    assert found.files == {tmp_path / "w.safetensors": 10}
    made = read_windows(tmp_path / "w.safetensors")
    assert (made.map_name, made.scene_names, made.windows) == ("street", ("scene-0061",), 10)
    assert built(OneDrive(drive()), nets, tmp_path / "d").files == {tmp_path / "d" / "street.safetensors": 10}


def test_logs_that_cannot_be_used_say_why(road: RoadMap, tmp_path: Path) -> None:
    away = replace(drive(), tracks=replace(drive().tracks, xy_m=drive().tracks.xy_m + 5000.0))
    with pytest.raises(
        SceneError, match=r"log: none of the 1 drives gives a window \(1 of 1: on none of the nets\)"
    ):
        built(OneDrive(away), LogNets((road,), None), tmp_path / "w")
    with pytest.raises(SceneError, match="no net was given"):
        built(OneDrive(drive()), LogNets((), None), tmp_path / "w")
    short = replace(drive(), tracks=drive().tracks.window(0, 12))
    with pytest.raises(SceneError, match="too short for a window of 8 s"):
        built(OneDrive(short), LogNets((road,), None), tmp_path / "w")
    with pytest.raises(ConfigError, match="--split val goes with the tables of nuScenes only"):
        built(OneDrive(drive()), LogNets((road,), None), tmp_path / "w", BuildOptions(split="val"))
    assert not list(tmp_path.iterdir())


def test_records_whose_names_begin_alike_are_on_nets_of_their_own(tmp_path: Path) -> None:
    """The names of real records differ after the first dot: sd_nuscenes_v1.0-mini_…, sd_training.tfrecord-…."""
    logs = tmp_path / "logs"
    for number, heading in enumerate((0.0, 1.0)):
        write(logs / f"sd_made_v1.0_{number}.pkl", record((100.0 * number, 0.0), heading))
    write(logs / "sub" / "sd_made_v1.0_0.pkl", record((0.0, 50.0), 2.0))
    write(logs / "sd_lost.pkl", record() | {"map_features": {}})
    found = built(ScenarioNetReader(logs), LogNets((), tmp_path / "nets"), tmp_path / "w")
    names = ["logs-sd_made_v1.0_0", "sd_made_v1.0_1", "sub-sd_made_v1.0_0"]
    assert [name for name, _ in found.drives] == names
    assert all(count > 0 for _, count in found.drives)
    (lost,) = found.skipped
    assert lost.drive == "sd_lost"
    assert "its map cannot be converted: " in lost.reason
    assert "holds no lane" in lost.reason
    assert sorted(path.name for path in (tmp_path / "nets").glob("*.net.xml")) == [
        "sd_made_v1.0_0-2.net.xml",
        "sd_made_v1.0_0.net.xml",
        "sd_made_v1.0_1.net.xml",
    ]
    scenes = [name for path in found.files for name in read_windows(path).scene_names]
    assert sorted(scenes) == sorted(names)
    again = built(ScenarioNetReader(logs), LogNets((), tmp_path / "nets"), tmp_path / "w")
    assert again == found
    assert len(list((tmp_path / "nets").glob("*.net.xml"))) == 3


def test_nets_of_one_name_and_drives_of_one_name_keep_apart(road: RoadMap, tmp_path: Path) -> None:
    nets = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        shutil.copy(road.path, tmp_path / folder / road.path.name)
        nets.append(RoadMap.read(tmp_path / folder / road.path.name))
    away = replace(drive(), tracks=replace(drive().tracks, xy_m=drive().tracks.xy_m + 5000.0))
    shifted = (tmp_path / "b" / road.path.name).read_text()
    (tmp_path / "b" / road.path.name).write_text(moved(shifted, 5000.0))
    nets[1] = RoadMap.read(nets[1].path)
    logs: list[tuple[Path, LogReader]] = [(Path("log"), OneDrive(drive())), (Path("more"), OneDrive(away))]
    found = build(logs, LogNets(tuple(nets), None), BuildOptions(), tmp_path / "w", lambda *_: None)
    files = {tmp_path / "w" / f"{folder}-street.safetensors": 10 for folder in ("a", "b")}
    assert found.files == files
    made = [read_windows(path) for path in files]
    assert [(one.map_name, one.scene_names) for one in made] == [
        ("a-street", ("scene-0061",)),
        ("b-street", ("scene-0061-2",)),
    ]


def moved(net: str, by_m: float) -> str:
    """Return the text of a net with all shapes moved by *by_m* along both axes."""

    def shifted(shape: re.Match[str]) -> str:
        points = (point.split(",") for point in shape[1].split())
        return f'shape="{" ".join(",".join(f"{float(v) + by_m:.2f}" for v in point) for point in points)}"'

    return re.sub(r'shape="([^"]*)"', shifted, net)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.data
def test_every_real_record_gives_windows(adv_data: Path, tmp_path: Path) -> None:
    folder = adv_data / "scenarionet"
    found = built(ScenarioNetReader(folder), LogNets((), tmp_path / "nets"), tmp_path / "w")
    assert found.skipped == []
    assert [name for name, count in found.drives if count] == sorted(
        path.stem for path in folder.glob("sd_*")
    )


@pytest.mark.data
def test_a_waymo_record_on_the_net_of_its_own_map(adv_data: Path, tmp_path: Path) -> None:
    record = next((adv_data / "scenarionet").glob("sd_training*.pkl"))
    nets = LogNets((), tmp_path / "nets")
    found = build(
        [(record, ScenarioNetReader(record))],
        nets,
        BuildOptions(),
        tmp_path / "w.safetensors",
        lambda *_: None,
    )
    made = read_windows(tmp_path / "w.safetensors")
    assert found.skipped == []
    assert made.windows >= 4
    # the focal vehicle of nearly every window stands on a lane
    focal = made.offset[:-1]
    lanes = made.near[focal, :28]
    away = np.linalg.norm(made.map_xy[lanes] - made.past[focal, -1, None, None, :2], axis=-1).min(axis=-1)
    assert np.mean(np.where(lanes >= 0, away, np.inf).min(axis=1) < 4.0) > 0.9


@pytest.mark.data
def test_the_challenge_needs_its_file_and_names_what_is_missing(adv_data: Path, tmp_path: Path) -> None:
    root = adv_data / "nuscenes-mini"
    reader = NuScenesReader(root)
    name = reader.names()[0]
    token, instant = next(iter(reader.instants(name).items()))
    assert instant == 0
    assert len(reader.instants(name)) >= 38
    if not (root / "maps" / "prediction").exists():
        options = BuildOptions(challenge=True)
        with pytest.raises(LogError, match=r"prediction_scenes\.json"):
            build([(root, reader)], LogNets((), tmp_path / "n"), options, tmp_path / "w", lambda *_: None)
    linked = tmp_path / "root"
    (linked / "maps" / "prediction").mkdir(parents=True)
    (linked / "v1.0-mini").symlink_to(root / "v1.0-mini")
    (linked / "maps" / "expansion").symlink_to(root / "maps" / "expansion")
    listed = linked / "maps" / "prediction" / "prediction_scenes.json"
    listed.write_text(json.dumps({name: [f"nobody_{token}", "nobody_nowhere"]}))
    with pytest.raises(LogError, match=f"names sample nowhere, which {name} does not have"):
        build(
            [(linked, NuScenesReader(linked))],
            LogNets((), tmp_path / "n"),
            BuildOptions(challenge=True),
            tmp_path / "w",
            lambda *_: None,
        )
