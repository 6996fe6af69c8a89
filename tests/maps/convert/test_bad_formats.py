"""Wrong values anywhere in maps of other formats give an error of one sentence, or a map without the wrong parts."""

from __future__ import annotations

import gzip
import random
import re
from pathlib import Path

import pytest
import small_sources

from advdiff_sumo.core.errors import InputError
from advdiff_sumo.maps.convert import convert_source
from advdiff_sumo.maps.convert.sources.read_map import read_map

WRONG = ("", "nan", "inf", "1e308", "-1", "x", "999999999", "0")
VALUE = re.compile(r'(?:="|>|: )(-?[\w.+-]+)(?="|<|,|})')
FILES = 60
KINDS = ("argoverse2", "commonroad", "lanelet2", "opendrive")


def text_of(kind: str, folder: Path) -> tuple[Path, str]:
    """Return the path of the small road in format *kind*, and its text."""
    if kind == "opendrive":
        source = read_map(small_sources.write("lanelet2", folder))
        convert_source(source, folder / "n.net.xml", opendrive=True)
        path = folder / "n.xodr"
    else:
        path = small_sources.write(kind, folder)
    content = path.read_bytes()
    return path, (gzip.decompress(content) if path.suffix == ".gz" else content).decode()


def write(path: Path, text: str) -> None:
    """Write a map, compressed if its name says so."""
    path.write_bytes(gzip.compress(text.encode(), mtime=0) if path.suffix == ".gz" else text.encode())


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_wrong_values_anywhere(kind: str, tmp_path: Path) -> None:
    path, text = text_of(kind, tmp_path)
    places = [match.span(1) for match in VALUE.finditer(text)]
    draw = random.Random(5)  # noqa: S311 - no secret
    refusals: list[str] = []
    for number in range(FILES):
        spoiled = text
        for first, last in sorted(draw.sample(places, draw.choice((1, 1, 3, 10))), reverse=True):
            spoiled = spoiled[:first] + draw.choice(WRONG) + spoiled[last:]
        if number % 10 == 9:
            spoiled = spoiled[: draw.randrange(len(spoiled))]
        write(path, spoiled)
        try:
            result = convert_source(read_map(path), tmp_path / "o.net.xml")
        except InputError as error:
            refusals.append(str(error))
        else:
            assert result.source.lanes
    assert 0 < len(refusals) < FILES
    assert not [text for text in refusals if "\n" in text or "fault of the converter" in text]


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("argoverse2", '"x": 50.0, "y": 1.75', '"x": 50.0, "y": 1e9'),
        ("commonroad", "<x>50.0</x><y>1.75</y>", "<x>50.0</x><y>1e308</y>"),
        ("opendrive", 'a="3.50000000" b="0" c="0"', 'a="3.50000000" b="0" c="1e8"'),
    ],
)
def test_a_place_far_away_leaves_a_lane_out(kind: str, old: str, new: str, tmp_path: Path) -> None:
    """Time and memory do not grow with the length of a boundary that has impossible coordinates."""
    path, text = text_of(kind, tmp_path)
    assert old in text
    write(path, text.replace(old, new, 1))
    source = read_map(path)
    assert 0 < len(source.lanes) < 4 or kind == "opendrive"
    assert sum(source.notes[name] for name in source.notes if "left out" in name or "unusable" in name) >= 1
    assert convert_source(source, tmp_path / "o.net.xml").source.lanes
