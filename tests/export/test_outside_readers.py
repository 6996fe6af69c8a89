"""Other people's programs read what is exported of everybody on a tiny crossing (see ``outside.py``).

sumo-gui needs a display, for which Debian's xvfb will do. Real nets: ``test_converted_nets.py``.
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sumolib
from lxml import etree

from advdiff_sumo.core.frames import wrap_angle
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.data import ScenarioNetReader
from advdiff_sumo.data.pickles import load_plain
from advdiff_sumo.export import ExportScene, make_exporter
from advdiff_sumo.maps.convert.sources.scenarionet_map import read_record_map
from advdiff_sumo.metrics.criticality import time_to_collision
from advdiff_sumo.metrics.following import following_gaps
from advdiff_sumo.sim.logs import LoggedTraffic
from advdiff_sumo.sim.sim_options import SceneOptions, SimOptions
from tests.export.outside import CommonRoadReader, netconverted, played, quality, same_obstacles, states_of
from tests.hang_guard import HANG_S
from tests.sim import nets

SUMO_HOME = Path(sumolib.checkBinary("netconvert")).resolve().parents[1]


def test_commonroad_io_reads_everybody(
    busy: ExportScene, commonroad: CommonRoadReader, tmp_path: Path
) -> None:
    found = commonroad(make_exporter("commonroad").write(busy, tmp_path)[0])
    tracks = busy.tracks
    assert found["dt"] == tracks.dt_s
    assert str(found["id"]).startswith("ZAM_CrossingPriority-1_1_T-1")
    assert found["start"] == pytest.approx([-30.0, -1.6, 8.0])
    assert found["lanelets"] == len(busy.lanes)
    assert found["links"] == len(busy.joints({lane.id for lane in busy.lanes})) > 0
    same_obstacles(found, busy)


def test_commonroad_keeps_its_schema(
    plain: ExportScene, busy: ExportScene, commonroad: CommonRoadReader, tmp_path: Path
) -> None:
    """Late arrivals break one rule of it, that obstacles begin at 0; commonroad-io writes them so itself."""
    path = make_exporter("commonroad").write(plain, tmp_path)[0]
    folder = Path(str(commonroad(path)["schema"])) / "xml_definition_files"
    schema = etree.XMLSchema(etree.parse(folder / "XML_commonRoad_XSD.xsd"))
    assert schema.validate(etree.parse(path)), schema.error_log
    assert not schema.validate(etree.parse(make_exporter("commonroad").write(busy, tmp_path)[0]))
    late = "is greater than the maximum value allowed ('0')"
    lone = "Expected is one of ( initialSignalState, trajectory, occupancySet )"
    said = [error.message for error in schema.error_log]
    assert (
        len(said) == 5
    )  # late, twice, for an instant: late; for an instant, at first only: nothing to drive
    assert all(late in message or lone in message for message in said), said


def test_commonroad_crime_agrees_on_ttc(
    plain: ExportScene, commonroad: CommonRoadReader, tmp_path: Path
) -> None:
    """It rounds to 0.01 s; the leader keeps 4 m/s, the target 12 m/s: (25 − 8 t) / 8."""
    steps = (0, 5, 10, 20)
    found = commonroad(make_exporter("commonroad").write(plain, tmp_path)[0], *steps)
    ours = time_to_collision(plain.tracks, plain.target)[0, list(steps)]
    lane = following_gaps(plain.tracks, plain.target, plain.road, ()).time_to_collision()[0, list(steps)]
    assert ours == pytest.approx([3.125 - 0.1 * step for step in steps])
    assert lane == pytest.approx(ours)
    assert found["ttc"] == pytest.approx(ours, abs=0.01)


def test_the_checker_of_openscenario_finds_nothing(busy: ExportScene, tmp_path: Path) -> None:
    assert (
        quality(
            "qc_openscenario", "xoscBundle", make_exporter("openscenario").write(busy, tmp_path)[0], tmp_path
        )
        == []
    )


def test_the_checker_of_opendrive_finds_nothing(busy: ExportScene, tmp_path: Path) -> None:
    assert (
        quality(
            "qc_opendrive", "xodrBundle", make_exporter("openscenario").write(busy, tmp_path)[1], tmp_path
        )
        == []
    )


def test_netconvert_reads_the_roads(busy: ExportScene, tmp_path: Path) -> None:
    again = netconverted(make_exporter("openscenario").write(busy, tmp_path)[1], tmp_path)
    assert len(again.getEdges()) == 8
    assert sum(len(edge.getOutgoing()) for edge in again.getEdges()) == 12


def test_sumo_plays_the_configuration(busy: ExportScene, tmp_path: Path) -> None:
    """Who drives on the road is where and when the data have it (see docs/exports.md on the others)."""
    data, _, config, _ = make_exporter("fcd").write(busy, tmp_path)
    written, there = states_of(data), played(config)
    for name in ("target", "agent_1", "gone:early"):
        steps = [key for key in written if key[0] == name]
        assert len(steps) >= 12
        for key in steps:
            assert there[key][:2] == pytest.approx(written[key][:2], abs=0.01)
            assert wrap_angle(np.deg2rad(there[key][2] - written[key][2])) == pytest.approx(0.0, abs=1e-3)


def test_sumo_gui_plays_the_configuration(busy: ExportScene, tmp_path: Path) -> None:
    """The window opens with network, lines and replayed vehicles, plays to the end and closes without a complaint."""
    display = [] if os.environ.get("DISPLAY") else [shutil.which("xvfb-run"), "--auto-servernum"]
    if None in display:
        pytest.skip("no display here: apt-get install xvfb")
    config = make_exporter("fcd").write(busy, tmp_path)[2]
    command = [*display, sumolib.checkBinary("sumo-gui"), "-c", config.name, "--start", "--quit-on-end"]
    command += ["--delay", "0", "--fcd-output", "played.xml", "--precision", "4"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=HANG_S)
    if "error while loading shared libraries" in done.stderr:
        pytest.skip(f"sumo-gui lacks a library of the system: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    assert {name for name, _ in states_of(tmp_path / "played.xml")} >= {"target", "agent_1", "gone:early"}


def test_sumo_s_schemas(busy: ExportScene, tmp_path: Path) -> None:
    files = make_exporter("fcd").write(busy, tmp_path)
    for path, name in zip(files, ("fcd_file", "additional_file", "sumoConfiguration"), strict=False):
        schema = etree.XMLSchema(etree.parse(SUMO_HOME / "data" / "xsd" / f"{name}.xsd"))
        assert schema.validate(etree.parse(path)), schema.error_log


def plain_types(value: object) -> bool:
    """Return whether MetaDrive's check of types passes (its ALLOW_TYPES, recursively)."""
    if isinstance(value, dict):
        return all(isinstance(key, str) and plain_types(item) for key, item in value.items())
    if isinstance(value, list | tuple):
        return all(plain_types(item) for item in value)
    return isinstance(value, int | float | str | np.ndarray | type(None))


def test_the_record_has_what_metadrive_asks_for(busy: ExportScene, tmp_path: Path) -> None:
    """The rules of ScenarioDescription.sanity_check with valid_check, MetaDrive 0.4."""
    path = make_exporter("scenarionet").write(busy, tmp_path)[0]
    record = load_plain(path)
    assert path.name.startswith("sd_")
    assert {"id", "version", "length", "tracks", "dynamic_map_states", "map_features"} < record.keys()
    assert {"ts", "metadrive_processed", "coordinate", "sdc_id"} < record["metadata"].keys()
    assert plain_types(record)
    length = record["length"]
    assert record["metadata"]["ts"].shape == (length,)
    for name, track in record["tracks"].items():
        assert track["type"] in {"VEHICLE", "CYCLIST", "PEDESTRIAN"}
        assert track["metadata"]["object_id"] == name
        valid = track["state"]["valid"]
        assert valid.sum() >= 1
        for values in track["state"].values():
            assert len(values) == length
            assert values.ndim in (1, 2)
            assert abs(values[..., :2][~valid].sum() if values.ndim == 2 else values[~valid].sum()) < 1e-2
    for feature in record["map_features"].values():
        assert feature["polyline"].shape[1] in (2, 3)


def test_the_record_is_a_log_and_a_map_of_ours(busy: ExportScene, tmp_path: Path) -> None:
    path = make_exporter("scenarionet").write(busy, tmp_path)[0]
    log = ScenarioNetReader(tmp_path).read(path.stem)
    assert log.tracks.ids[log.ego] == "target"
    source = read_record_map(load_plain(path), path)
    assert len(source.lanes) == len(busy.lanes) > 8
    assert len(source.links) == len(busy.joints({lane.id for lane in busy.lanes}))


def test_an_episode_can_start_from_the_record(on_net: Callable[..., ExportScene], tmp_path: Path) -> None:
    scene = on_net(nets.street(tmp_path), 101)
    make_exporter("scenarionet").write(scene, tmp_path)
    log = ScenarioNetReader(tmp_path)
    seeds = list(LoggedTraffic(scene.road, log, SceneOptions(), SimOptions(), SeedTree(0)).scenes())
    assert len(seeds) >= 1
    assert {seed.target for seed in seeds} == {"ego"}
    assert seeds[0].history.agents == 2


@pytest.mark.data
def test_the_record_has_the_keys_of_real_ones(adv_data: Path, busy: ExportScene, tmp_path: Path) -> None:
    ours = load_plain(make_exporter("scenarionet").write(busy, tmp_path)[0])
    for path in sorted((adv_data / "scenarionet").glob("sd_*.pkl")):
        real = load_plain(path)
        assert real.keys() <= ours.keys()
        theirs, mine = next(iter(real["tracks"].values())), next(iter(ours["tracks"].values()))
        assert theirs["state"].keys() <= mine["state"].keys()


def test_a_csv_is_a_csv(busy: ExportScene, tmp_path: Path) -> None:
    with make_exporter("csv").write(busy, tmp_path)[0].open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == int(busy.tracks.valid.sum())
    assert [row["time_s"] for row in rows] == sorted((row["time_s"] for row in rows), key=float)
    assert {row["agent"] for row in rows} == set(busy.tracks.ids)
    (first,) = [row for row in rows if row["agent"] == "target" and float(row["time_s"]) == 0.0]
    assert float(first["x_m"]) == -30.0
    assert first["is_target"] == "true"
