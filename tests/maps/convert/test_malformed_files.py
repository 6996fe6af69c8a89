"""Files that cannot be used give exit code 2 and one sentence with file, problem and remedy."""

from __future__ import annotations

import random
import re
import sqlite3
import tempfile
from collections import Counter
from contextlib import closing
from pathlib import Path

import pytest
import small_sources
from malformed_files import NAMES, Malformed, malformed
from test_bad_formats import FILES

from advdiff_sumo.core.errors import ConfigError, InputError, MapError
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.sources.read_map import read_map
from advdiff_sumo.sim.measured_conversion import ConvertOptions, convert_and_measure
from tests.e2e.commands import advdiff
from tests.sim.records_made import record, write

with tempfile.TemporaryDirectory() as _folder:
    CASES = list(malformed(Path(_folder)))
PARAMS = [pytest.param(case, id=f"{case.kind}: {case.fault}") for case in CASES]


def is_one_sentence(text: str, path: Path) -> bool:
    """Return whether *text* states the problem of *path* and, after a semicolon, the remedy."""
    return text.startswith(f"{path}: ") and "; " in text and "\n" not in text and len(text) < 600


def test_there_are_sixty_malformed_files() -> None:
    by_kind = Counter(case.kind for case in CASES)
    assert len(CASES[::3]) >= 60  # the files for which the command is run
    assert by_kind.keys() == NAMES.keys()
    assert min(by_kind.values()) >= 20
    assert len({(case.kind, case.fault) for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", PARAMS)
def test_malformed_files_get_one_sentence(case: Malformed, tmp_path: Path) -> None:
    path = case.put(tmp_path)
    with pytest.raises(InputError) as caught:
        convert_and_measure(path, tmp_path / "n.net.xml", ConvertOptions())
    assert is_one_sentence(str(caught.value), path)
    assert not (tmp_path / "n.net.xml").exists()


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMES)
def test_the_command_ends_with_2(kind: str, tmp_path: Path) -> None:
    """The command is run for every third file."""
    cases = [case for case in CASES if case.kind == kind][::3]
    for number, case in enumerate(cases):
        (folder := tmp_path / str(number)).mkdir()
        path = case.put(folder)
        done = advdiff("convert", path, "-o", folder / "n.net.xml", cwd=tmp_path)
        assert done.code == 2, case.fault
        assert is_one_sentence(done.err.strip().removeprefix("error: "), path), case.fault
        assert done.out == ""


WRONG = (None, "", "nan", "x", -1, 3.5, 1e308, float("inf"), 10**18, b"", b"GP", b"\xff" * 60, "1")


def _spoil_values(path: Path, draw: random.Random) -> None:
    """Put wrong values into some cells of any layers."""
    with closing(sqlite3.connect(path)) as base, base:
        tables = [row[0] for row in base.execute("SELECT name FROM sqlite_master WHERE type='table'")]
        layers = [name for name in sorted(tables) if not re.match("gpkg_|rtree_|sqlite_", name)]
        for _ in range(draw.choice((1, 1, 3, 10))):
            layer = draw.choice(layers)
            columns = [row[1] for row in base.execute(f"PRAGMA table_info({layer})")][1:]
            rows = [row[0] for row in base.execute(f"SELECT rowid FROM {layer}")]  # noqa: S608 - our own names
            change = f"UPDATE {layer} SET {draw.choice(columns)} = ? WHERE rowid = ?"  # noqa: S608 - as above
            base.execute(change, (draw.choice(WRONG), draw.choice(rows)))


def _spoil_bytes(path: Path, draw: random.Random) -> None:
    content = bytearray(path.read_bytes())
    for _ in range(draw.choice((1, 3, 10, 100))):
        content[draw.randrange(len(content))] = draw.randrange(256)
    path.write_bytes(content)


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [_spoil_values, _spoil_bytes])
def test_wrong_values_anywhere_in_nuplan(spoil: object, tmp_path: Path) -> None:
    assert callable(spoil)
    draw = random.Random(11)  # noqa: S311 - no secret
    refusals: list[tuple[str, Path]] = []
    for number in range(FILES):
        (folder := tmp_path / str(number)).mkdir()
        path = small_sources.write("nuplan", folder)
        spoil(path, draw)
        try:
            result = convert_source(read_map(path), folder / "n.net.xml")
        except MapError as error:
            refusals.append((str(error), path))
        else:
            assert result.source.lanes
    assert 0 < len(refusals) < FILES
    assert all(is_one_sentence(text, path) for text, path in refusals)


SMALL_FAULTS = {
    "UPDATE lanes_polygons SET lane_fid = NULL WHERE lane_fid = '1'": "id is null",
    "UPDATE lanes_polygons SET lane_fid = '2' WHERE lane_fid = '1'": "occurs twice ('lane_2')",
    "UPDATE lane_connectors SET entry_lane_fid = '99'": "connector_3 names lane_99, which is not in the file",
    "UPDATE baseline_paths SET geom = NULL WHERE lane_fid = '4'": "lane_4 has no usable baseline path",
}


@pytest.mark.parametrize("change", SMALL_FAULTS)
def test_small_faults_are_told_and_the_rest_is_converted(change: str, tmp_path: Path) -> None:
    path = small_sources.write("nuplan", tmp_path)
    with closing(sqlite3.connect(path)) as base, base:
        base.execute(change)
    source = read_map(path)
    assert [text for text in source.warnings if SMALL_FAULTS[change] in text]
    assert sum(source.notes.values()) == len(source.warnings)
    assert len(convert_source(source, tmp_path / "n.net.xml").source.lanes) >= 3


def test_ids_are_the_same_as_numbers_and_as_text(tmp_path: Path) -> None:
    path = small_sources.write("nuplan", tmp_path)
    whole = read_map(path)
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("ALTER TABLE lane_connectors ADD COLUMN way REAL")
        base.execute("UPDATE lane_connectors SET way = CAST(exit_lane_fid AS REAL)")
        base.execute("ALTER TABLE lane_connectors DROP COLUMN exit_lane_fid")
        base.execute("ALTER TABLE lane_connectors RENAME COLUMN way TO exit_lane_fid")
    assert read_map(path).links == whole.links


@pytest.mark.parametrize("name", ["q.txt", "q.net.xml.gz", "q.net"])
def test_a_net_with_the_ending_of_another_file_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=rf"{re.escape(name)}: a net is NAME\.net\.xml; give that, or NAME alone"
    ):
        convert_and_measure(tmp_path / "map.xodr", tmp_path / name, ConvertOptions())
    assert list(tmp_path.iterdir()) == []


def test_a_net_goes_into_a_folder_under_the_name_of_its_map(tmp_path: Path) -> None:
    path = write(tmp_path / "sd_made_v1.0_a.pkl", record(told=True))
    (tmp_path / "there").mkdir()
    for folder in (tmp_path / "there", f"{tmp_path / 'new'}/"):
        net = convert_and_measure(path, folder, ConvertOptions()).net
        assert net == Path(folder) / "sd_made_v1.0_a.net.xml"
        assert net.is_file()
    assert not list(tmp_path.glob("*.net.xml"))


def test_a_sumo_net_needs_no_conversion(tmp_path: Path, networks: Path) -> None:
    with pytest.raises(
        MapError, match=r"downtown\.net\.xml: is a SUMO net already; give it as it is, with --net"
    ):
        convert_and_measure(networks / "downtown.net.xml", tmp_path / "a.net.xml", ConvertOptions())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "<routes/>",
            "begins with <routes>, so it is no map of a known format; give a nuScenes map expansion",
        ),
        ("<OpenDRIVE/>", r"begins with <OpenDRIVE> but ends with \.xml; let its name end with \.xodr"),
        ("<osm/>", r"begins with <osm> but ends with \.xml; let its name end with \.osm"),
    ],
)
def test_other_xml_is_not_taken_for_a_commonroad_scenario(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text(text)
    with pytest.raises(MapError, match=said):
        convert_and_measure(path, tmp_path / "a.net.xml", ConvertOptions())
