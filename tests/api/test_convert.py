"""``ads.convert`` has the same options and results as the command."""

from __future__ import annotations

import inspect
import json
import sys
from pathlib import Path

import pytest

import advdiff_sumo as ads
from advdiff_sumo.cli.convert import convert as command
from advdiff_sumo.core.errors import ConfigError, MapError
from advdiff_sumo.sim.measured_conversion import ConvertOptions
from tests.e2e.commands import advdiff

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "maps" / "convert"))

from test_osm import road_both_ways, town


def test_every_option_of_the_command_is_one_of_the_function() -> None:
    jobs = {"map_file", "output", "all_of"}
    assert set(inspect.signature(command).parameters) - jobs == set(ConvertOptions.model_fields)


def test_the_same_files_as_the_command(tmp_path: Path) -> None:
    """Both use streets beyond the rim, return edges, guessed signals and crossings, OpenDRIVE, report and test."""
    hd_map, osm = road_both_ways(tmp_path), town().write(tmp_path / "town.osm")
    words = ("--osm", osm, "--close-rim", "--tls", "guess", "--crossings", "guess", "--opendrive", "--report")
    more = ("--drive", 5, "--seed", 3, "--righthand")
    done = advdiff("convert", hd_map, "-o", tmp_path / "command" / "n", *words, *more, cwd=tmp_path)
    assert done.code == 0, done.err
    converted = ads.convert(
        str(hd_map),
        tmp_path / "python" / "n",
        osm=str(osm),
        close_rim=True,
        tls="guess",
        crossings="guess",
        opendrive=True,
        report=True,
        drive=5,
        seed=3,
        lefthand=False,
    )
    assert converted.net == tmp_path / "python" / "n.net.xml"
    names = sorted(path.name for path in (tmp_path / "command").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "python").iterdir())
    for name in names:
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "command" / name).read_bytes(), name
    assert converted.figures == json.loads((tmp_path / "python" / "n.fidelity.json").read_text("utf-8"))
    assert converted.figures["driving_test_in_the_hour"]["vehicles"] == 5
    assert converted.result.streets is not None
    assert converted.warnings == converted.result.source.warnings


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"ozm": "town.osm"}, r"ads\.convert: no option 'ozm'; .*osm"),
        ({"tls": "all"}, "tls = 'all'"),
        ({"crossings": "some"}, "crossings = 'some'"),
        ({"drive": -1}, "drive = -1"),
        ({"tls_cycle": "many"}, "tls_cycle = 'many'"),
    ],
)
def test_unknown_options_and_values_are_refused(
    options: dict[str, object], problem: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=problem) as caught:
        ads.convert(road_both_ways(tmp_path), tmp_path / "n", **options)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "n.net.xml").exists()


def test_a_file_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"none\.gpkg: cannot be read"):
        ads.convert(tmp_path / "none.gpkg", tmp_path / "n")
