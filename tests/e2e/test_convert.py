"""A nuScenes map becomes a net, and a drive that was logged there becomes an episode."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.e2e.commands import Outcome, advdiff

pytestmark = pytest.mark.data


def test_from_a_map_and_a_log_to_an_episode(
    adv_data: Path, workplace: Path, here: Callable[..., Outcome]
) -> None:
    log = adv_data / "nuscenes-mini"
    hd_map = log / "maps" / "expansion" / "singapore-onenorth.json"
    converted = advdiff("convert", hd_map, "-o", "onenorth.net.xml", cwd=workplace)
    assert (converted.code, converted.err) == (0, "")
    assert "onenorth.net.xml: " in converted.out
    figures = json.loads((workplace / "onenorth.fidelity.json").read_text())
    assert figures["centre_line_error_m"]["source_to_net"]["max"] < 0.01

    words = ("--background", "replay", "--episodes", 1, "--horizon", 3, "--out", "run")
    done = here("run", "--net", "onenorth.net.xml", "--scenes", log, *words)
    assert done.code == 0, done.err
    (episode,) = pq.read_table(workplace / "run" / "episodes.parquet").to_pylist()
    assert episode["scene"].startswith("scene-0061")
    assert episode["end"] in {"horizon", "collision"}
    states = pq.read_table(workplace / "run" / "states.parquet").to_pylist()
    movers = {row["controller"] for row in states if not row["is_target"]}
    assert movers == {"policy", "replayed"}
