"""The names of attacks match the policies' options and can be imported fast."""

from __future__ import annotations

import subprocess
import sys
from typing import get_args, get_type_hints

from advdiff_sumo.cli import run_flags
from advdiff_sumo.traffic.attack_names import KIND_NAMES, RECKLESS_ATTACKS
from advdiff_sumo.traffic.diffusion.diffusion_options import LAWFUL_ATTACKS, DiffusionOptions
from advdiff_sumo.traffic.scripted.scripted_policy import ScriptedOptions


def test_help_lists_the_attacks_that_the_policies_accept() -> None:
    (option,) = get_args(run_flags.Attack)[1:]
    lawful, reckless = option.help.removesuffix(".").split("; with --licence reckless: ")
    assert lawful.partition(": ")[2].split(", ") == [*get_args(get_type_hints(ScriptedOptions)["attack"])]
    assert set(KIND_NAMES) <= set(LAWFUL_ATTACKS)
    assert reckless.split(", ") == [*RECKLESS_ATTACKS]
    assert set(KIND_NAMES) | set(RECKLESS_ATTACKS) == set(
        get_args(get_type_hints(DiffusionOptions)["attack"])
    )


def test_names_can_be_imported_without_numpy() -> None:
    code = "import sys, advdiff_sumo.traffic.attack_names; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
