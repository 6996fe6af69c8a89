"""Truncated or damaged gzip files (nets, demand, maps, logs, records) give one sentence with file and remedy."""

from __future__ import annotations

import gzip
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import FileError, InputError
from advdiff_sumo.data import open_log
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.demand_files import read_demand
from advdiff_sumo.sim.source_maps import read_source
from tests.sim.records_made import record

DAMAGED = "the gzip data are cut off or damaged; copy or make the file anew"
DAMAGED_RECORD = "the gzip data are cut off or damaged; copy or convert the record again"
SCENARIO = b"<commonRoad>" + b"<!-- some words to pack -->" * 400 + b"</commonRoad>"


def routes(count: int = 900) -> bytes:
    """Return more routes than a check of demand reads."""
    names = np.random.default_rng(1).integers(10**9, size=count)  # which compress badly
    rows = (
        f'<vehicle id="{names[k]}-{k}" depart="{k}"><route edges="WM ME"/></vehicle>' for k in range(count)
    )
    return f"<routes>{''.join(rows)}</routes>".encode()


def read_log(path: Path) -> object:
    return list(open_log(path).scenes())


def damaged(packed: bytes) -> Iterator[bytes]:
    """Yield *packed* truncated in its head, its middle and its last bytes, with another checksum and with a gap."""
    yield from (packed[:size] for size in (3, 12, len(packed) // 2, len(packed) - 9, len(packed) - 1))
    yield packed[:-8] + bytes(8)
    yield packed[:40] + bytes(20) + packed[60:]
    yield packed[:2] + b"\x07" + packed[3:]


@pytest.fixture(scope="module")
def road(street: Path) -> RoadMap:
    return RoadMap.read(street)


def refusals(path: Path, whole: bytes, read: Callable[[Path], object]) -> set[str]:
    """Return the messages of *read* for *path* with *whole* damaged in each way; it must refuse each."""
    said = set()
    for content in damaged(gzip.compress(whole, mtime=0)):
        path.write_bytes(content)
        with pytest.raises(InputError) as refused:
            read(path)
        said.add(str(refused.value))
    return said


def test_a_net_and_its_side_car(street: Path, tmp_path: Path) -> None:
    net, area = tmp_path / "n.net.xml.gz", tmp_path / "m.poly.xml.gz"
    assert refusals(net, street.read_bytes(), RoadMap.read) == {f"{net}: {DAMAGED}"}
    (tmp_path / "m.net.xml").write_bytes(street.read_bytes())
    drivable = b'<additional><poly type="drivable_area" shape="0,0 400,0 400,9 0,9"/></additional>'
    said = refusals(area, drivable, lambda _: RoadMap.read(tmp_path / "m.net.xml"))
    assert said == {f"{area}: {DAMAGED}"}


def test_demand_also_behind_what_is_looked_at(road: RoadMap, tmp_path: Path) -> None:
    demand, extra = tmp_path / "d.rou.xml.gz", tmp_path / "t.add.xml.gz"
    assert refusals(demand, routes(), lambda path: read_demand(path, road)) == {f"{demand}: {DAMAGED}"}
    (tmp_path / "d.rou.xml.gz").write_bytes(gzip.compress(routes(), mtime=0))
    assert read_demand(tmp_path / "d.rou.xml.gz", road).begin_s == 0.0
    (tmp_path / "all.sumocfg").write_text(
        '<configuration><input><route-files value="d.rou.xml.gz"/><additional-files value="t.add.xml.gz"/>'
        "</input></configuration>"
    )
    types = b'<additional><vType id="mine" maxSpeed="3"/></additional>'
    with pytest.raises(FileError, match=r"t\.add\.xml\.gz: no such"):
        read_demand(tmp_path / "all.sumocfg", road)
    said = refusals(extra, types, lambda _: read_demand(tmp_path / "all.sumocfg", road))
    assert said == {f"{extra}: {DAMAGED}"}


@pytest.mark.parametrize("read", [read_source, read_log], ids=["map", "log"])
def test_a_scenario(tmp_path: Path, read: Callable[[Path], object]) -> None:
    path = tmp_path / "a.xml.gz"
    assert refusals(path, SCENARIO, read) == {f"{path}: {DAMAGED}"}


@pytest.mark.parametrize("read", [read_source, read_log], ids=["map", "log"])
def test_a_record_that_was_gzipped(tmp_path: Path, read: Callable[[Path], object]) -> None:
    whole = pickle.dumps(record(), protocol=4)
    path = tmp_path / "sd_a.pkl"
    assert refusals(path, whole, read) == {f"{path}: {DAMAGED_RECORD}"}
    path.write_bytes(gzip.compress(whole))
    read(path)
    path.write_bytes(whole[:-100])
    with pytest.raises(InputError, match=r"sd_a\.pkl: is truncated; copy or convert the record again"):
        read(path)
    path.rename(tmp_path / "sd_a.pkl.gz")
    with pytest.raises(InputError, match=r"sd_a\.pkl\.gz: .*unpack .*first, with gunzip"):
        read(tmp_path / "sd_a.pkl.gz")
