"""Taking scenes out of a batch and repeating them."""

from __future__ import annotations

from dataclasses import fields

import torch

from advdiff_sumo.models.batch import SceneBatch


def test_repeat_keeps_copies_of_a_scene_together(batch: SceneBatch) -> None:
    made = batch.repeat(3)
    assert (made.scenes, made.agents) == (6, batch.agents)
    for field in fields(SceneBatch):
        value = getattr(batch, field.name)
        assert torch.equal(getattr(made, field.name), value[[0, 0, 0, 1, 1, 1]]), field.name


def test_rows(batch: SceneBatch) -> None:
    for rows in (torch.tensor([1]), slice(1, 2)):
        made = batch.rows(rows)
        assert made.scenes == 1
        assert torch.equal(made.pose, batch.pose[1:])
        assert torch.equal(made.map_valid, batch.map_valid[1:])


def test_to_moves_every_tensor(batch: SceneBatch) -> None:
    made = batch.to("meta")
    assert all(getattr(made, f.name).device.type == "meta" for f in fields(SceneBatch))
