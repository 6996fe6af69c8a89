"""A file of weights says what it holds where it is taken for another one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from advdiff_sumo.core.errors import WeightsError
from advdiff_sumo.core.weights_formats import CONTENTS
from advdiff_sumo.models import bundle, failure_predictor, reward, simnet
from advdiff_sumo.models.bundle import load_bundle
from advdiff_sumo.models.model_options import ModelOptions
from advdiff_sumo.models.simnet import load_simnet, new_simnet, save_simnet
from advdiff_sumo.models.stored import write_stored
from advdiff_sumo.traffic.rl import actor
from advdiff_sumo.training import checkpoint


def test_every_format_has_its_words() -> None:
    modules = (bundle, simnet, reward, failure_predictor, actor, checkpoint)
    assert {module.FORMAT for module in modules} == set(CONTENTS)


def test_a_simnet_is_no_traffic_model(options: ModelOptions, tmp_path: Path) -> None:
    path = tmp_path / "s.safetensors"
    save_simnet(new_simnet(options), path)
    with pytest.raises(WeightsError) as caught:
        load_bundle(path)
    assert str(caught.value) == (
        f"{path}: is not of the format advdiff-weights-1, it holds the network of SimNet; "
        "name a file that holds a traffic model"
    )


def test_what_nobody_knows_keeps_its_remedy(tmp_path: Path) -> None:
    path = tmp_path / "s.safetensors"
    write_stored(path, {}, {"format": "advdiff-simnet-0"})
    with pytest.raises(WeightsError, match=r"is not of the format advdiff-simnet-1; train it again"):
        load_simnet(path)


def test_others_may_read_weights_and_checkpoints_as_any_file(tmp_path: Path) -> None:
    plain = tmp_path / "plain.json"
    plain.write_text("{}")
    write_stored(tmp_path / "weights.safetensors", {"a": np.ones(2)}, {"format": "advdiff-bundle-1"})
    checkpoint.save(tmp_path, checkpoint.TrainingProgress("traffic", {}, ""), {"model": {"a": torch.ones(2)}})
    assert {file.name: file.stat().st_mode for file in tmp_path.iterdir()} == dict.fromkeys(
        ("plain.json", "weights.safetensors", checkpoint.NAME), plain.stat().st_mode
    )
