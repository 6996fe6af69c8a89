"""The table of ``bench fewshot``, of episodes that are made up."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.experiments.bench.bench_config import Folder, Request
from advdiff_sumo.experiments.bench.cells import BenchCell
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult, Gathered
from advdiff_sumo.experiments.bench.fewshot import GUIDES, fewshot_table
from advdiff_sumo.experiments.bench.scene_list import ListedScene, SceneList
from advdiff_sumo.experiments.bench.traces import UNTRACED
from advdiff_sumo.experiments.bench.transfer import transfer_table
from advdiff_sumo.metrics.statistics import wilson
from advdiff_sumo.traffic.licence import LicenceName

SCENES = SceneList(
    nets={}, sumo="", scenes=tuple(ListedScene(net="motorway", seed=1, number=number) for number in range(2))
)


def met(hits: int) -> list[EpisodeResult]:
    """Return the two scenes' episodes, in the first *hits* of which the target collides."""
    return [EpisodeResult(f"s{k}", {"target_collision": k < hits}, UNTRACED, None) for k in range(2)]


@pytest.mark.parametrize(
    "name", ["EIDM", "exec:/opt/planner --at {address}", "grpc://localhost:50051", "exec:sh -c 'a/0/0'"]
)
def test_names_of_targets_may_hold_slashes_and_braces(name: str, tmp_path: Path) -> None:
    """No collision at first, one of the four episodes of two warm-ups after a plan, all after two."""
    hits = {(0, 0): 0, (0, 1): 1, (1, 1): 0, (0, 2): 2, (1, 2): 2}
    rungs = [(guide, rung) for guide in GUIDES for rung in hits]
    gathered = Gathered(
        {BenchCell(f"{guide}/{name}/{s}/{k}", name, "diffusion"): met(hits[s, k]) for guide, (s, k) in rungs}
    )
    folder = Folder(tmp_path, Request(bench="fewshot", seeds=2, steps=2))
    table = fewshot_table(gathered, SCENES, folder)
    keys = [(line.key, line.group, line.title) for line in table.lines]
    assert keys == [(f"{guide}/{name}", GUIDES[guide], name) for guide in GUIDES]
    for line in table.lines:
        rates = [line.cells[f"steps_{mark}"].found.value for mark in (0, 1, 2)]
        assert rates == [0.0, 0.25, 1.0]
        none, _, all_of_them = (line.cells[f"steps_{mark}"].found for mark in (0, 1, 2))
        assert (none.low, none.high) == pytest.approx(wilson(0, 2))
        assert (all_of_them.low, all_of_them.high) == pytest.approx(wilson(2, 2))  # four trials of two scenes


@pytest.mark.parametrize(
    ("licence", "said"), [(None, "refits Q alone"), ("reckless", "refits Q alone"), ("lawful", "Q stays")]
)
def test_the_notes_tell_of_the_warm_up_that_takes_place(
    licence: LicenceName | None, said: str, tmp_path: Path
) -> None:
    """Q is refitted under the paper's licence alone; under others encounters are learnt."""
    cells = [BenchCell(f"{guide}/EIDM/0/{k}", "EIDM", "diffusion") for guide in GUIDES for k in (0, 1)]
    folder = Folder(tmp_path, Request(bench="fewshot", seeds=1, steps=1, licence=licence))
    notes = fewshot_table(Gathered({cell: met(1) for cell in cells}), SCENES, folder).notes
    assert said in notes[0]
    assert ("refits" in notes[0]) == (licence != "lawful")
    row = BenchCell("adv-rl/lane_graph", "IDM", "adv-rl")
    transferred = Folder(tmp_path, Request(bench="transfer", licence=licence))
    (told,) = (n for n in transfer_table(Gathered({row: []}), SCENES, transferred).notes if "A row is" in n)
    assert ("Q warmed up" in told) == (licence != "lawful")
