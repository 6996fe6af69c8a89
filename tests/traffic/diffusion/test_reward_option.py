"""The option ``reward`` of guided traffic: a reward model, or the result of a lawful warm-up."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.models.shipped_weights import shipped_weights
from advdiff_sumo.traffic.diffusion.diffusion_options import DiffusionOptions

LEARNED = str(shipped_weights("failures"))


def options(**values: str) -> DiffusionOptions:
    return DiffusionOptions.parse(values, "options")


def test_nothing_by_default() -> None:
    assert options().preference is None
    assert options().q_file == ""


def test_the_result_of_a_lawful_warm_up_is_no_reward_model() -> None:
    for licence in ("lawful", "careless"):
        assert options(reward=LEARNED, licence=licence).preference is not None
    assert options(reward=LEARNED).q_file == ""


def test_reckless_traffic_has_no_lawful_encounters() -> None:
    with pytest.raises(WeightsError, match="--licence reckless has none"):
        _ = options(reward=LEARNED, licence="reckless").preference


def test_another_file_is_a_reward_model(tmp_path: Path) -> None:
    path = str(tmp_path / "q.safetensors")
    assert options(reward=path).q_file == path
    assert options(reward=path).preference is None
