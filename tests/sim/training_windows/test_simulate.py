"""Simulated windows: random nets, mixed traffic, and which windows are left out."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import FileError, NetError
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data.window_files import read_windows
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.training_windows.driver_types import CAR_FOLLOWING, KINDS, driver_types
from advdiff_sumo.sim.training_windows.random_nets import write_random_net
from advdiff_sumo.sim.training_windows.simulate import ShardResult, SimulateOptions, plan, simulate
from advdiff_sumo.sim.training_windows.simulation_run import _has_overlaps, _is_drivable, record


@pytest.mark.parametrize("kind", ["grid", "spider", "rand", "motorway"])
@pytest.mark.parametrize("seed", [1, 2])
def test_made_up_nets_can_be_driven_and_depend_on_their_seed_alone(
    tmp_path: Path, kind: str, seed: int
) -> None:
    tree = SeedTree(seed).child("net")
    first = write_random_net(kind, tree, tmp_path / "a.net.xml")
    again = write_random_net(kind, tree, tmp_path / "b.net.xml")
    assert first.read_bytes() == again.read_bytes()
    road = RoadMap.read(first)
    assert len(road.edge_graph().strongly_connected()) > (1 if kind != "motorway" else 0)
    assert not any(link.direction in "tT" for link in road.links.values())
    if kind == "motorway":
        assert max(edge.speed_mps for edge in road.edges.values()) > 20.0
        assert all(edge.successors or road.edges[name].to_junction for name, edge in road.edges.items())


def test_drivers_differ_and_cover_every_kind() -> None:
    types = driver_types(np.random.default_rng(0))
    assert {driver.kind for driver in types} == set(KINDS)
    assert {driver.attributes["carFollowModel"] for driver in types} == set(CAR_FOLLOWING)
    for driver in types:
        low, high = KINDS[driver.kind].length_m
        assert low - 1e-3 <= float(driver.attributes["length"]) <= high + 1e-3
    assert len({driver.attributes["tau"] for driver in types}) == len(types)


def test_the_plan_takes_given_and_made_up_nets_in_turn() -> None:
    shards = plan(SimulateOptions.parse({"windows": 2400, "seed": 7}))
    assert sum(shard.windows for shard in shards) == 2400
    assert [shard.net is None for shard in shards] == [False, True] * 4
    assert [s.net.name.split(".")[0] for s in shards if s.net] == [
        "downtown",
        "downtown-left",
        "motorway",
        "downtown",
    ]
    assert [shard.kind for shard in shards if shard.net is None] == ["grid", "rand", "spider", "grid"]
    assert len({shard.name for shard in shards}) == len(shards)
    assert all(s.net is None for s in plan(SimulateOptions.parse({"windows": 600, "random_share": 1.0})))
    with pytest.raises(NetError, match="no such net"):
        plan(SimulateOptions.parse({"nets": ("nowhere.net.xml",)}))


def test_workers_do_not_change_a_byte_and_complete_files_are_kept(
    tmp_path: Path, crossing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("advdiff_sumo.sim.training_windows.simulate.SHARD_WINDOWS", 16)

    def made(folder: str, workers: int) -> list[ShardResult]:
        values = {"windows": 32, "nets": (str(crossing),), "random_share": 0.0, "seed": 3}
        return simulate(plan(SimulateOptions.parse(values)), tmp_path / folder, workers, lambda _: None)

    first, second = made("one", 1), made("two", 2)
    assert [r.windows for r in first] == [r.windows for r in second]
    files = sorted((tmp_path / "one").glob("*.safetensors"))
    assert len(files) == 2
    for path in files:
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
    before = files[0].stat().st_mtime_ns
    assert [r.windows for r in made("one", 1)] == [r.windows for r in first]
    assert files[0].stat().st_mtime_ns == before
    found = read_windows(files[0])
    assert found.windows == first[0].windows
    assert len(found.scene_names) > 1  # several simulations
    assert np.diff(found.offset).max() <= 24
    now = found.past[:, -1]
    for w in range(found.windows):
        here = now[found.rows(w), :2]
        assert np.linalg.norm(here - here[0], axis=1).max() <= 60.01
    files[0].rename(files[0].with_name("crossing-priority-4-0000.safetensors"))
    values = {"windows": 32, "nets": (str(crossing),), "random_share": 0.0, "seed": 4}
    with pytest.raises(FileError, match="made with other options"):
        simulate(plan(SimulateOptions.parse(values)), tmp_path / "one", 1, lambda _: None)


def test_files_of_another_net_of_the_same_name_are_not_taken_for_those_of_this_one(
    tmp_path: Path, crossing: Path, unregulated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("advdiff_sumo.sim.training_windows.simulate.SHARD_WINDOWS", 8)
    for folder, net in {"a": crossing, "b": unregulated}.items():
        (tmp_path / folder).mkdir()
        shutil.copy(net, tmp_path / folder / "town.net.xml")
    values = {"windows": 8, "random_share": 0.0, "seed": 3}
    shards = {
        folder: plan(SimulateOptions.parse(values | {"nets": (str(tmp_path / folder / "town.net.xml"),)}))
        for folder in ("a", "b")
    }
    simulate(shards["a"], tmp_path / "out", 1, lambda _: None)
    with pytest.raises(FileError, match="made with other options"):
        simulate(shards["b"], tmp_path / "out", 1, lambda _: None)


def test_traffic_is_recorded_at_2_hz_at_box_centres(crossing: Path) -> None:
    made = record(RoadMap.read(crossing), SeedTree(1))
    tracks = made.tracks
    assert tracks.dt_s == 0.5
    assert tracks.steps == len(made.signals) == 57
    both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    way = np.linalg.norm(np.diff(tracks.xy_m, axis=1), axis=-1)[both]
    speed = (0.5 * (tracks.speed_mps[:, 1:] + tracks.speed_mps[:, :-1]))[both]
    assert np.quantile(np.abs(way - 0.5 * speed), 0.95) < 0.3
    still = np.nanmax(
        np.nanmax(tracks.xy_m[made.parked], axis=1) - np.nanmin(tracks.xy_m[made.parked], axis=1), initial=0
    )
    assert still < 0.5


def cars(**changed: np.ndarray) -> Tracks:
    """Return two cars at 10 m/s eastwards, 4 m abreast."""
    xy = np.zeros((2, 17, 2))
    xy[:, :, 0] = 5.0 * np.arange(17)
    xy[1, :, 1] = 4.0
    full = np.ones((2, 17))
    made = Tracks(
        ("a", "b"),
        np.zeros(2, dtype=np.int64),
        np.array([[4.5, 1.8]] * 2),
        xy,
        0.0 * full,
        10.0 * full,
        full > 0,
        0.0,
        0.5,
    )
    return replace(made, **changed)


def test_boxes_that_share_area_are_found() -> None:
    rows = np.arange(2)
    assert not _has_overlaps(cars(), rows, 4)
    xy = cars().xy_m.copy()
    xy[1, 12, 1] = 1.55  # the boxes are shrunk by 10 cm on each side
    assert _has_overlaps(cars(xy_m=xy), rows, 4)
    xy[1, 12, 1] = 1.65
    assert not _has_overlaps(cars(xy_m=xy), rows, 4)


def test_what_no_vehicle_can_do_is_found() -> None:
    rows = np.arange(2)
    assert _is_drivable(cars(), rows, 4)
    for name, step, value in (("speed_mps", 8, 4.0), ("yaw_rad", 8, 1.0)):
        values = getattr(cars(), name).copy()
        values[1, step:] = value
        assert not _is_drivable(cars(**{name: values}), rows, 4), name
    aside = cars().xy_m.copy()
    aside[0, 9:, 1] += 1.0
    assert not _is_drivable(cars(xy_m=aside), rows, 4)
