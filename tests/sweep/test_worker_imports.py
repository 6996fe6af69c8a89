"""Imports of a worker before its first episode: few sweeps need PyTorch, which takes longer than all else."""

import subprocess
import sys

import pytest

SLOW_TO_IMPORT = "{'torch', 'scipy.stats', 'scipy.signal'}"


@pytest.mark.parametrize(
    "modules",
    [
        "advdiff_sumo.sweep.worker_sandbox, advdiff_sumo.cli.sweep_results, advdiff_sumo.experiments.judge_folder",
        "advdiff_sumo.traffic.scripted.scripted_policy, advdiff_sumo.traffic.replay, advdiff_sumo.traffic.sumo_traffic",
        "advdiff_sumo.planners.lane_graph, advdiff_sumo.planners.reference, advdiff_sumo.planners.defects.catalogue",
        "advdiff_sumo.models.shipped_weights, advdiff_sumo.sim.training_windows.handback",
    ],
)
def test_without_networks_no_slow_library_is_imported(modules: str) -> None:
    code = f"import sys, {modules}\nprint(sorted({SLOW_TO_IMPORT} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout == "[]\n"


def test_a_built_in_is_found_by_any_spelling_and_a_users_class_is_none() -> None:
    from advdiff_sumo.traffic.policy_registry import POLICIES

    assert POLICIES.builtin_module("Adv_RL") == "advdiff_sumo.traffic.rl.adv_rl_policy"
    assert POLICIES.builtin_module("my_package:Policy") is None
    assert POLICIES.is_builtin("Adv_RL")
    assert POLICIES.is_builtin(POLICIES.builtins["adv-rl"])
    assert not POLICIES.is_builtin("my_package:Policy")
