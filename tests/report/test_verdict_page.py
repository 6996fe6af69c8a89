"""What the page tells of verdicts: badges, sentences, filters, and the careful driver beside the target."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from advdiff_sumo.report.careful_driver import drive_of, tracks_of
from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.nets import NetLayers
from advdiff_sumo.report.page import write_report
from advdiff_sumo.report.series import series_of
from advdiff_sumo.report.templates import near_miss_sentence
from tests.metrics.encounter_folder import encounter_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encounter_folder(tmp_path_factory.mktemp("verdicts"))


def drive(folder: Path, episode: int):
    run = FinishedRun.read(folder)
    row, states = run.row(episode), run.states(episode)
    assert states is not None
    layer = NetLayers(run).layer(str(row["net"]))
    assert layer is not None
    return drive_of(run, row, states, layer.road), states


def test_badges_sentences_and_filters(folder: Path) -> None:
    page = write_report(folder).read_text(encoding="utf-8")
    for word in ("valid failure", "not counted", "critical"):
        assert f">{word}</span>" in page
    assert "Even a careful and competent driver" in page or "A careful and competent driver" in page
    for name, values in (
        ("verdict", ("valid failure", "not counted", "critical")),
        ("breach", ("ran_into", "red_light")),
        ("kind", ("junction", "rear_end_striking")),
    ):
        choice = page.partition(f'<select name="{name}">')[2].partition("</select>")[0]
        assert all(f'<option value="{value}">' in choice for value in values), name
    assert 'data-breach="red_light"' in page


def test_the_careful_driver_starts_where_the_target_was_and_stays_clear(folder: Path) -> None:
    taken, states = drive(folder, 0)
    assert taken is not None
    careful = tracks_of(taken, states)
    step = taken.takeover_step
    assert careful.xy_m[0, 0] == pytest.approx(states.tracks.xy_m[states.target, step], abs=0.05)
    assert careful.t0_s == pytest.approx(0.1 * step)
    assert step + careful.steps <= states.tracks.steps
    lead = states.tracks.index["lead"]
    gap = states.tracks.xy_m[lead, step:, 0] - careful.xy_m[0, :, 0] - 4.0
    assert gap.min() > 0.0
    series = series_of(states, "lead", taken)
    assert np.isnan(series.reference_mps[:step]).all()
    assert series.reference_accel_mps2[step:].min() < -2.0


def test_a_critical_near_miss_has_its_careful_driver_too(folder: Path) -> None:
    taken, _ = drive(folder, 2)
    assert taken is not None
    assert taken.accel_mps2.min() < -2.0


def test_a_critical_near_miss_names_its_partner_and_moment(folder: Path) -> None:
    row = pq.read_table(folder / "episodes.parquet").to_pylist()[2]
    assert (row["near_miss_partner"], row["critical"]) == ("cutter", True)
    sentence = near_miss_sentence(row)
    assert sentence.startswith(f"Near miss with 'cutter' at {row['near_miss_time_s']:.1f}")
    assert sentence in write_report(folder).read_text(encoding="utf-8").replace("&#39;", "'")
    older = near_miss_sentence({**row, "near_miss_partner": None, "near_miss_time_s": None})
    assert older.startswith("A careful driver would have had to brake at")
