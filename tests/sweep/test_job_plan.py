"""Keys: equal for equal content, and different if any of it differs."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from advdiff_sumo.core.errors import ConfigError
from tests.sweep.conftest import planned


def test_the_same_content_gives_the_same_keys_in_another_folder(place: Path, tmp_path: Path) -> None:
    shutil.copy(place / "small.net.xml", tmp_path / "small.net.xml")
    here = planned(place, grid=_grid(place))
    there = planned(tmp_path, grid=_grid(tmp_path))
    assert [job.key for job in here.jobs] == [job.key for job in there.jobs]
    assert list(here.batches) == list(there.batches)


@pytest.mark.parametrize(
    "change",
    [
        {"horizon_s": 4.0},
        {"seeds": [1]},
        {"sim": {"control_radius_m": 50.0}},
        {"grid": {"targets": ["Krauss"]}},
        {"grid": {"backgrounds": ["replay"]}},
        {"grid": {"targets": [{"name": "IDM", "options": {"tau": 1.5}}]}},
        {"scene": {"warmup_s": 9.0}},
    ],
    ids=str,
)
def test_any_other_content_gives_other_keys(place: Path, change: dict[str, Any]) -> None:
    grid = {**_grid(place), **change.pop("grid", {})}
    before, after = planned(place, grid=_grid(place)), planned(place, grid=grid, **change)
    assert {job.key for job in before.jobs}.isdisjoint(job.key for job in after.jobs)


def test_another_net_of_the_same_name_gives_other_keys(place: Path, tmp_path: Path) -> None:
    text = (place / "small.net.xml").read_text()
    (tmp_path / "small.net.xml").write_text(text + "<!-- edited -->\n")
    before, after = planned(place, grid=_grid(place)), planned(tmp_path, grid=_grid(tmp_path))
    assert {job.scene_key for job in before.jobs}.isdisjoint(job.scene_key for job in after.jobs)


def test_targets_and_backgrounds_share_their_seed_scenes(place: Path) -> None:
    grid = _grid(place) | {"targets": ["IDM", "Krauss"], "backgrounds": ["sumo", "replay"]}
    plan = planned(place, grid=grid, episodes=3, seeds=[0, 1])
    assert len(plan.jobs) == 4 * 3 * 2
    assert len({job.key for job in plan.jobs}) == len(plan.jobs)
    assert len({job.scene_key for job in plan.jobs}) == 3 * 2
    assert len(plan.batches) == 2 * 2  # two scenes a warm-up
    for job in plan.jobs:
        assert (job.number // 2, job.scene_index) == (plan.batches[job.batch].number, job.number % 2)
    wanted = [batch.scenes for batch in plan.batches.values()]
    assert wanted == [2, 1, 2, 1]  # up to the last one that an episode starts in


def test_more_episodes_keep_the_keys_of_the_first_ones(place: Path) -> None:
    few, many = planned(place, grid=_grid(place)), planned(place, grid=_grid(place), episodes=5)
    assert [job.key for job in few.jobs] == [job.key for job in many.jobs[:2]]


def test_later_episodes_keep_their_keys_without_the_earlier_ones(place: Path) -> None:
    whole, later = planned(place, episodes=5), planned(place, episodes=2, first_episode=3)
    assert [job.number for job in later.jobs] == [3, 4]
    assert [(job.key, job.scene_key) for job in later.jobs] == [
        (job.key, job.scene_key) for job in whole.jobs[3:]
    ]
    assert [(job.index, job.scene_index) for job in later.jobs] == [(0, 1), (1, 0)]  # two scenes a warm-up
    assert [(batch.number, batch.scenes) for batch in later.batches.values()] == [(1, 2), (2, 1)]


def test_an_episode_is_found_by_the_beginning_of_its_key(place: Path) -> None:
    plan = planned(place, grid=_grid(place))
    job = plan.jobs[1]
    assert plan.find(job.key[:10]) is job
    with pytest.raises(ConfigError, match="belongs to no episode"):
        plan.find("zzzzzz")
    with pytest.raises(ConfigError, match="is the beginning of 2 keys"):
        plan.find("")


def _grid(place: Path) -> dict[str, Any]:
    return {"nets": [str(place / "small.net.xml")], "targets": ["IDM"], "backgrounds": ["sumo"]}
