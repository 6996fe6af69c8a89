"""Plans with the shipped weights use machine code only, from the noise to the gradients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from advdiff_sumo.core.scene import Scene
from advdiff_sumo.diffusion.machine_code import Fitting
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.traffic.diffusion.diffusion_policy import DiffusionTraffic
from tests.diffusion.shipped_code import assert_close, checked_against_networks, needs_code

Street = Callable[..., Scene]
CROWD = [(60.0, 0.0), (78.0, 3.0), (42.0, 3.0), (95.0, 0.0)]
SPEEDS = [8.0, 7.0, 9.0, 6.0]
USED = {
    "lawful": ("denoiser-2827", "decoder-step-bd77", "reward-37f6", "attack-costs"),
    "reckless": ("denoiser-c6dc", "decoder-step-d3a5", "reward-8e47", "attack-slope"),
}


@needs_code
@pytest.mark.parametrize("licence", sorted(USED))
def test_a_guided_plan(
    licence: str, downtown: RoadMap, street: Street, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If this fails, machine code for a part of planning is missing: run ``python tools/build_machine_code.py``."""
    policy = DiffusionTraffic(licence=licence, guide="reward")
    fits: list[bool] = []
    holds = Fitting.holds
    monkeypatch.setattr(Fitting, "holds", lambda own, given: fits.append(holds(own, given)) or fits[-1])
    scene, rng = street(CROWD, SPEEDS), np.random.default_rng(0)
    with checked_against_networks() as errors:
        policy.plan(downtown, scene, policy.start(downtown, scene, None, rng), rng)
    assert_close(errors, *USED[licence])
    assert fits
    assert all(fits)
