"""Options of ``margin`` from the file of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.cli.margin import _without_varied
from advdiff_sumo.cli.margin_subject import MarginSubject, described_subject
from advdiff_sumo.experiments.margin import scale_of
from advdiff_sumo.experiments.margin_command import margin_command
from advdiff_sumo.sim.run_episodes import RunOptions


def test_kind_and_severity_of_an_earlier_attack_are_left_out_of_the_command_that_repeats_it() -> None:
    earlier = {"attack": "cut-in", "braking_mps2": 3.0, "spare_gap_m": 2.0, "attackers": 1}
    options = RunOptions(background="scripted", background_options=earlier)
    kept = _without_varied(options, [("hard-stop", scale_of("hard-stop", None))])
    assert kept.background_options == {"spare_gap_m": 2.0, "attackers": 1}
    command = margin_command(kept, 0, "hard-stop")
    assert "--set background_options.spare_gap_m=2.0" in command
    assert "background_options.attack=" not in command
    assert "braking_mps2" not in command


@pytest.mark.parametrize(
    ("header", "number"), [("repeats = 2", 2), ("repeats = 0", 0), ("libsumo = '1.28.0'", 0)]
)
def test_the_file_of_a_replayed_episode_stands_for_its_scene(
    tmp_path: Path, header: str, number: int
) -> None:
    path = tmp_path / "run.toml"
    path.write_text(f"[run]\n{header}\n\n[options]\nseed = 3\n")
    assert described_subject(None, path, None, None) == MarginSubject(number, "hard-stop")
    assert described_subject(5, path, "cut-in", None) == MarginSubject(5, "cut-in")


def test_the_encounter_of_an_episode_is_varied_by_its_braking() -> None:
    assert MarginSubject(0, "cut-in").default_scale is None
    assert MarginSubject(0, "cut-in", asked_attack="any").default_scale == "braking"
    assert MarginSubject(0, "pull-out", asked_attack="any").default_scale is None
