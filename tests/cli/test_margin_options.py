"""Options of ``margin`` from the file of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.cli.margin import _without_varied, other_scene_note
from advdiff_sumo.experiments.margin import scale_of
from advdiff_sumo.experiments.margin_command import margin_command
from advdiff_sumo.sim.run_episodes import RunOptions


def test_kind_and_severity_of_an_earlier_attack_are_left_out_of_the_command_that_repeats_it() -> None:
    earlier = {"attack": "cut-in", "braking_mps2": 3.0, "spare_gap_m": 2.0, "attackers": 1}
    options = RunOptions(background="scripted", background_options=earlier)
    kept = _without_varied(options, [("hard-stop", scale_of("hard-stop", None))])
    assert kept.background_options == {"spare_gap_m": 2.0, "attackers": 1}
    command = margin_command(kept, "hard-stop")
    assert "--set background_options.spare_gap_m=2.0" in command
    assert "background_options.attack=" not in command
    assert "braking_mps2" not in command


@pytest.mark.parametrize(
    ("header", "is_noted"), [("repeats = 2", True), ("repeats = 0", False), ("libsumo = '1.28.0'", False)]
)
def test_the_file_of_a_replayed_episode_of_another_scene_is_noted(
    tmp_path: Path, header: str, is_noted: bool
) -> None:
    path = tmp_path / "run.toml"
    path.write_text(f"[run]\n{header}\n\n[options]\nseed = 3\n")
    noted = other_scene_note(path, 3)
    expected = f"{path} repeats episode 2, but this margin is that of episode 0 of seed 3, another seed scene"
    assert noted == (expected if is_noted else "")
    assert other_scene_note(None, 3) == ""
