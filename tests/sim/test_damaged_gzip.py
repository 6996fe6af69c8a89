"""Gzipped nets, demand, maps, logs and records that are cut off or damaged: one sentence with the file and a remedy."""

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

DAMAGED = r"the gzip data are cut off or damaged; copy or (make the file anew|convert the record again)"
SCENARIO = b"<commonRoad>" + b"<!-- some words to pack -->" * 400 + b"</commonRoad>"


def routes(count: int = 900) -> bytes:
    """Return more routes than a check of demand looks at."""
    names = np.random.default_rng(1).integers(10**9, size=count)  # which do not pack well
    rows = (
        f'<vehicle id="{names[k]}-{k}" depart="{k}"><route edges="WM ME"/></vehicle>' for k in range(count)
    )
    return f"<routes>{''.join(rows)}</routes>".encode()


def read_log(path: Path) -> object:
    return list(open_log(path).scenes())


def damaged(packed: bytes) -> Iterator[bytes]:
    """Yield *packed* cut off in its head, its middle and its last bytes, with another checksum and with a gap."""
    yield from (packed[:size] for size in (3, 12, len(packed) // 2, len(packed) - 9, len(packed) - 1))
    yield packed[:-8] + bytes(8)
    yield packed[:40] + bytes(20) + packed[60:]
    yield packed[:2] + b"\x07" + packed[3:]


@pytest.fixture(scope="module")
def road(street: Path) -> RoadMap:
    return RoadMap.read(street)


def check(path: Path, whole: bytes, read: Callable[[Path], object]) -> None:
    for content in damaged(gzip.compress(whole, mtime=0)):
        path.write_bytes(content)
        with pytest.raises(InputError, match=rf"^{path}: {DAMAGED}$"):
            read(path)


def test_a_net_and_its_side_car(street: Path, tmp_path: Path) -> None:
    check(tmp_path / "n.net.xml.gz", street.read_bytes(), RoadMap.read)
    (tmp_path / "m.net.xml").write_bytes(street.read_bytes())
    area = b'<additional><poly type="drivable_area" shape="0,0 400,0 400,9 0,9"/></additional>'
    check(tmp_path / "m.poly.xml.gz", area, lambda _: RoadMap.read(tmp_path / "m.net.xml"))


def test_demand_also_behind_what_is_looked_at(road: RoadMap, tmp_path: Path) -> None:
    check(tmp_path / "d.rou.xml.gz", routes(), lambda path: read_demand(path, road))
    (tmp_path / "d.rou.xml.gz").write_bytes(gzip.compress(routes(), mtime=0))
    assert read_demand(tmp_path / "d.rou.xml.gz", road).begin_s == 0.0
    (tmp_path / "all.sumocfg").write_text(
        '<configuration><input><route-files value="d.rou.xml.gz"/><additional-files value="t.add.xml.gz"/>'
        "</input></configuration>"
    )
    types = b'<additional><vType id="mine" maxSpeed="3"/></additional>'
    with pytest.raises(FileError, match=r"t\.add\.xml\.gz: no such"):
        read_demand(tmp_path / "all.sumocfg", road)
    check(tmp_path / "t.add.xml.gz", types, lambda _: read_demand(tmp_path / "all.sumocfg", road))


@pytest.mark.parametrize("read", [read_source, read_log], ids=["map", "log"])
def test_a_scenario(tmp_path: Path, read: Callable[[Path], object]) -> None:
    check(tmp_path / "a.xml.gz", SCENARIO, read)


@pytest.mark.parametrize("read", [read_source, read_log], ids=["map", "log"])
def test_a_record_that_was_gzipped(tmp_path: Path, read: Callable[[Path], object]) -> None:
    whole = pickle.dumps(record(), protocol=4)
    path = tmp_path / "sd_a.pkl"
    check(path, whole, read)
    path.write_bytes(gzip.compress(whole))
    read(path)
    path.write_bytes(whole[:-100])
    with pytest.raises(InputError, match=r"sd_a\.pkl: is truncated; copy or convert the record again"):
        read(path)
    path.rename(tmp_path / "sd_a.pkl.gz")
    with pytest.raises(InputError, match=r"sd_a\.pkl\.gz: .*unpack .*first, with gunzip"):
        read(tmp_path / "sd_a.pkl.gz")
