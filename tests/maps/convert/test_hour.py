"""An hour of traffic with 300 vehicles on nets of every source, without lasting blockage and without collision."""

from __future__ import annotations

from pathlib import Path

import pytest
from signal_checks import LEAST_SIGNALS, check_signals
from source_writers import write_lanelet2, write_nuplan

from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.sim.driving_test import driving_test

pytestmark = [pytest.mark.data, pytest.mark.slow]
MAPS = (
    "commonroad/DEU_Moabit-4_1_T-1.xml.gz",
    "commonroad/HRV_Pula-27_3_T-1.xml.gz",
    "commonroad/USA_Lanker-1_3_T-1.xml.gz",
    "commonroad/ZAM_Tjunction-1_97_T-1.xml.gz",
    "argoverse2/log_map_archive_0a1e6f0a-1817-4a98-b02e-db8c9327d151.json",
    "argoverse2/log_map_archive_3b3570b4-7b0b-3268-a571-b0889dbf40b6____MIA_city_47894.json",
    "argoverse2/log_map_archive_adcf7d18-0510-35b0-a2fa-b4cea13a6d76____PIT_city_57819.json",
    "nuscenes-mini/maps/expansion/singapore-onenorth.json",
    pytest.param("nuscenes-mini/maps/expansion/singapore-queenstown.json", marks=pytest.mark.nightly),
    pytest.param("nuscenes-mini/maps/expansion/singapore-hollandvillage.json", marks=pytest.mark.nightly),
    pytest.param("nuscenes-mini/maps/expansion/boston-seaport.json", marks=pytest.mark.nightly),
)
BARS = ("teleports", "collisions_sumo", "collisions_boxes")


@pytest.mark.parametrize("name", MAPS)
def test_nobody_is_stuck_and_nobody_collides(name: str, adv_data: Path, tmp_path: Path) -> None:
    result = convert_source(read_map(adv_data / name), tmp_path / "n.net.xml", guess_signals=True)
    assert check_signals(result.net) >= LEAST_SIGNALS.get(name, 0)
    figures = driving_test(result.net, vehicles=300, seed=1)
    assert {bar: figures[bar] for bar in BARS} == dict.fromkeys(BARS, 0)
    assert figures["arrived"] >= 250


@pytest.mark.parametrize("kind", ["nuplan", "lanelet2", "opendrive"])
def test_nobody_collides_on_a_city_in_formats_without_genuine_files(
    kind: str, adv_data: Path, tmp_path: Path
) -> None:
    """One-north in the formats of nuPlan, Lanelet2 and OpenDRIVE."""
    source = read_map(adv_data / "nuscenes-mini/maps/expansion/singapore-onenorth.json")
    if kind == "nuplan":
        write_nuplan(source, path := tmp_path / "map.gpkg")
    elif kind == "lanelet2":
        write_lanelet2(source, path := tmp_path / "m.osm")
    else:
        convert_source(source, tmp_path / "m.net.xml", opendrive=True)
        path = tmp_path / "m.xodr"
    result = convert_source(read_map(path), tmp_path / "n.net.xml", guess_signals=True)
    figures = driving_test(result.net, vehicles=300, seed=1)
    assert {bar: figures[bar] for bar in BARS} == dict.fromkeys(BARS, 0)
    assert figures["arrived"] >= 250


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (2, 3))])
def test_ways_that_cross_twice_are_parted_by_edges(seed: int, adv_data: Path, tmp_path: Path) -> None:
    """Connections of the square in Pula are up to 67 m long and cross twice; SUMO's drivers notice one crossing."""
    source = read_map(adv_data / "commonroad/HRV_Pula-27_3_T-1.xml.gz")
    result = convert_source(source, tmp_path / "n.net.xml")
    figures = driving_test(result.net, vehicles=300, seed=seed)
    assert {bar: figures[bar] for bar in BARS} == dict.fromkeys(BARS, 0)
