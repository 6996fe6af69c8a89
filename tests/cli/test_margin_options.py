"""Options of ``margin`` from the file of a run."""

from __future__ import annotations

from advdiff_sumo.cli.margin import _without_varied
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
