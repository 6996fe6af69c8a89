"""Every format keeps the contract: same bytes twice, and back within 1 cm and 0.1°."""

from __future__ import annotations

import pickle
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from advdiff_sumo.core.arrays import stretches
from advdiff_sumo.core.errors import ConfigError, FileError, MissingExtraError, UnknownNameError
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data import ScenarioNetReader
from advdiff_sumo.data.scenarionet_log import read_record
from advdiff_sumo.export import (
    EXPORTERS,
    ExportScene,
    ImportedScene,
    check_exporter,
    import_scene,
    make_exporter,
)
from advdiff_sumo.export.csv_export import Csv
from advdiff_sumo.export.export_check import compare
from advdiff_sumo.export.export_scene import MARGIN_M, decimal_text, seconds_text
from advdiff_sumo.export.net_opendrive import plan_of
from tests.export.drives import DT_S, straight, tracks_of

BUILT_IN = tuple(EXPORTERS.builtins)


@pytest.mark.parametrize("name", BUILT_IN)
def test_everybody_comes_back(name: str, busy: ExportScene) -> None:
    assert check_exporter(make_exporter(name), busy) == []


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_ending_tells_the_format(name: str, plain: ExportScene, tmp_path: Path) -> None:
    files = make_exporter(name).write(plain, tmp_path)
    read = import_scene(files[0])
    assert list(compare(read, plain)) == []
    assert read.tracks.ids[read.target] == "ego"
    assert read.tracks.speed_mps[read.target] == pytest.approx(12.0, abs=0.01)


def test_another_step(plain: ExportScene, tmp_path: Path) -> None:
    scene = replace(plain, tracks=replace(plain.tracks, dt_s=0.05))
    for name in BUILT_IN:
        read = make_exporter(name).read(make_exporter(name).write(scene, tmp_path)[0])
        assert read.tracks.dt_s == pytest.approx(0.05)
        assert list(compare(read, scene)) == []


@pytest.mark.parametrize("name", BUILT_IN)
def test_who_creeps_or_shifts_a_little_comes_back_where_it_was(
    name: str, plain: ExportScene, tmp_path: Path
) -> None:
    steps = 101
    time = DT_S * np.arange(steps)
    stops = straight(-60.0, -1.6, 0.0, 0.0, steps=steps)
    stops[:, 0] += 0.24 * np.minimum(time, 3.0)  # creeps for 3 s, then stands
    stops[:, 3] = np.where(time < 3.0, 0.24, 0.0)
    tracks = tracks_of(
        ("ego", AgentClass.CAR, (5.0, 1.8), straight(-90.0, -1.6, 0.0, 1.0, steps=steps)),
        ("creeps", AgentClass.CAR, (5.0, 1.8), straight(-70.0, -1.6, 0.0, 0.1, steps=steps)),
        ("stops", AgentClass.CAR, (5.0, 1.8), stops),
        ("shifts", AgentClass.BICYCLE, (1.8, 0.6), straight(-50.0, -6.0, 0.05, 0.19, steps=steps)),
        ("strolls", AgentClass.PEDESTRIAN, (0.5, 0.5), straight(8.0, -10.0, 1.5, 0.1, steps=steps)),
    )
    scene = replace(plain, tracks=tracks, target=0)
    read = make_exporter(name).read(make_exporter(name).write(scene, tmp_path)[0])
    assert list(compare(read, scene)) == []


def test_a_simulated_record_is_a_log_without_annotations(plain: ExportScene, tmp_path: Path) -> None:
    tracks = tracks_of(
        ("ego", AgentClass.CAR, (5.0, 1.8), straight(-90.0, -1.6, 0.0, 1.0, steps=101)),
        ("creeps", AgentClass.CAR, (5.0, 1.8), straight(-70.0, -1.6, 0.0, 0.1, steps=101)),
    )
    (path,) = make_exporter("scenarionet").write(replace(plain, tracks=tracks, target=0), tmp_path)
    log = ScenarioNetReader(path).read(path.stem)
    np.testing.assert_allclose(log.tracks.xy_m, tracks.xy_m, rtol=0.0, atol=1e-9)


def test_speeds_of_a_measured_record_are_those_of_its_log(plain: ExportScene, tmp_path: Path) -> None:
    """The velocities of who stands jitter in records of others; their places are calmed, and so are the speeds."""
    tracks = tracks_of(
        ("ego", AgentClass.CAR, (5.0, 1.8), straight(-90.0, -1.6, 0.0, 1.0, steps=101)),
        ("stands", AgentClass.CAR, (5.0, 1.8), straight(-70.0, -1.6, 0.0, 0.0, steps=101)),
    )
    (path,) = make_exporter("scenarionet").write(replace(plain, tracks=tracks, target=0), tmp_path)
    record = read_record(path)
    record["metadata"]["dataset"] = "waymo"
    record["tracks"]["stands"]["state"]["velocity"][::2, 0] = -0.5
    path.write_bytes(pickle.dumps(record))
    np.testing.assert_array_equal(import_scene(path).tracks.speed_mps[1], np.zeros(101))


class Shifted(Csv):
    """Reads everything 2 cm further east."""

    def read(self, path: Path) -> ImportedScene:
        read = super().read(path)
        return replace(read, tracks=replace(read.tracks, xy_m=read.tracks.xy_m + np.array([0.02, 0.0])))


class Counting(Csv):
    """Writes other bytes each time."""

    count = 0

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        files = super().write(scene, folder)
        Counting.count += 1
        (folder / f"{scene.name}.count").write_text(str(Counting.count))
        return (*files, folder / f"{scene.name}.count")


class Turned(Csv):
    """Reads headings 0.2° off."""

    def read(self, path: Path) -> ImportedScene:
        read = super().read(path)
        return replace(read, tracks=replace(read.tracks, yaw_rad=read.tracks.yaw_rad + np.deg2rad(0.2)))


class Elsewhere(Csv):
    """Names its file after nobody."""

    def write(self, scene: ExportScene, folder: Path) -> tuple[Path, ...]:
        return (super().write(scene, folder)[0].rename(folder / "x.csv"),)


class Gullible(Csv):
    """Reads anything."""

    def read(self, path: Path) -> ImportedScene:
        if path.read_bytes().startswith(b"\x00"):
            return self.last
        self.last = super().read(path)
        return self.last


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (Shifted(), "positions differ by up to 0.0200 m"),
        (Turned(), "headings differ by up to 0.2000°"),
        (Counting(), "other bytes a second time"),
        (Elsewhere(), "does not hold the scene's name"),
        (Gullible(), "read takes a damaged file"),
        (object(), "write raised AttributeError"),
    ],
)
def test_the_checker_finds_what_is_broken(broken: Csv, said: str, plain: ExportScene) -> None:
    problems = check_exporter(broken, plain)
    assert any(said in problem for problem in problems), problems


def test_names_resolve_and_near_misses_are_told() -> None:
    assert type(make_exporter("OpenSCENARIO")).__name__ == "OpenScenario"
    assert type(make_exporter("advdiff_sumo.export.csv_export:Csv")) is Csv
    with pytest.raises(UnknownNameError, match="did you mean 'commonroad'"):
        make_exporter("comonroad")
    with pytest.raises(ConfigError, match="is no exporter: it lacks write and read"):
        make_exporter("builtins:object")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": "../up"}, "is no name for files"),
        ({"name": ""}, "is no name for files"),
    ],
)
def test_scenes_that_cannot_be(change: dict[str, str], said: str, plain: ExportScene) -> None:
    with pytest.raises(ValueError, match=said):
        replace(plain, **change)
    with pytest.raises(ValueError, match="not at 0"):
        replace(plain, tracks=plain.tracks.shifted(1.0))
    nobody = replace(plain.tracks, valid=np.zeros_like(plain.tracks.valid))
    with pytest.raises(ValueError, match="never there"):
        replace(plain, tracks=nobody)


@pytest.mark.parametrize("away_m", [49.97, 50.03])
def test_lanes_are_those_within_the_margin(plain: ExportScene, away_m: float) -> None:
    """Seen from 3° beside the end of the lane that reaches farthest east: a rounded buffer falls short by 6 cm."""
    lines = {lane.id: shapely.linestrings(lane.centre_xy_m) for lane in plain.road.lanes.values()}
    end = max((p for line in lines.values() for p in line.coords), key=lambda p: (p[0], p[1]))
    turned = np.deg2rad(90.0 / 32.0)
    place = np.array(end) + away_m * np.array([np.cos(turned), np.sin(turned)])
    tracks = tracks_of(("ego", AgentClass.CAR, (5.0, 1.8), straight(*place, 0.0, 0.0)))
    near = {name for name, line in lines.items() if shapely.distance(line, shapely.points(place)) <= MARGIN_M}
    assert {lane.id for lane in replace(plain, tracks=tracks, target=0).lanes} == near
    assert (len(near) > 0) is (away_m < MARGIN_M)


def test_stretches_and_numbers() -> None:
    assert list(stretches(np.array([True, True, False, True]))) == [(0, 2), (3, 4)]
    assert list(stretches(np.zeros(3, dtype=np.bool_))) == []
    assert (decimal_text(-0.00001), decimal_text(-1.5, 2), decimal_text(1e-9)) == (
        "0.0000",
        "-1.50",
        "0.0000",
    )
    assert (seconds_text(0, 0.1), seconds_text(3, 0.1), seconds_text(1, 0.025)) == ("0.0", "0.3", "0.025")


def test_lanes_and_ways_of_the_crossing(busy: ExportScene) -> None:
    """8 edges of one lane; from each of the four entries left, straight and right."""
    plan = plan_of(busy.road)
    assert len(plan.edges) == 8
    assert len(plan.connections) == 12
    for way in plan.connections:
        lane = busy.road.lanes[f"{way.origin[0]}_{way.origin[1]}"]
        assert way.shape_m[0] == pytest.approx(lane.centre_xy_m[-1])


def test_an_unknown_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"\.xosc, \.cr\.xml"):
        import_scene(tmp_path / "a.docx")


def test_without_the_extra(plain: ExportScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in sys.modules if n.startswith(("scenariogeneration", "advdiff_sumo.export.story"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "advdiff_sumo.export.story", raising=False)
    monkeypatch.setitem(sys.modules, "scenariogeneration", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'advdiff-sumo\[openscenario\]'"):
        make_exporter("openscenario").write(plain, tmp_path)
    assert list(tmp_path.iterdir()) == []
