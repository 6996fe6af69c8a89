"""``bench fewshot``: collision rate by steps of warm-up, for targets unknown to Q (the paper's Fig. 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.wording import counted
from advdiff_sumo.experiments.bench.adapt import Adaptation, adapt
from advdiff_sumo.experiments.bench.adversarial import notes_of
from advdiff_sumo.experiments.bench.bench_config import Folder, Request, chosen_names
from advdiff_sumo.experiments.bench.bench_rows import PAPERS_LICENCE, refits_q, with_licence
from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells, plan_cells
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult, Gathered
from advdiff_sumo.experiments.bench.intervals import RESAMPLES, Difference, Estimate, Ratio, estimate
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.requested_scenes import bench_scenes
from advdiff_sumo.experiments.bench.scene_list import TABLE_LIST, SceneList
from advdiff_sumo.experiments.bench.table import Cell, Gap, Head, Line, Table
from advdiff_sumo.metrics.statistics import TAILS, widened_interval, wilson
from advdiff_sumo.planners.planner_registry import TARGETS, make_target
from advdiff_sumo.sweep.tasks import WorkerLimits

RUNGS = 3


@dataclass(frozen=True)
class Unseen:
    """A target that Q was not trained with.

    Attributes:
        target: as registered.
        options: of it.
    """

    target: str
    options: Mapping[str, Any] = field(default_factory=dict)


UNSEEN: Mapping[str, Unseen] = {
    "EIDM": Unseen("EIDM"),
    "W99": Unseen("W99"),
    "lane_graph-brisk": Unseen("lane_graph", {"speed_factor": 1.15, "time_headway_s": 0.8, "gap_s": 0.8}),
}
GUIDES: Mapping[str, str] = {
    "reward-only": "guided by Q alone",
    "reward": "guided by Q and the attack's terms",
}
"""Guides of the rows, in warm-up and evaluation: the paper's and the default one."""
ALL = "all targets"
REFITTED = "refits Q alone (Sec. III-C)"
LEARNT = (
    "learns in which encounters it fails, by which manoeuvres are chosen; Q stays (docs/lawful-attacks.md)"
)
"""What a warm-up does under the paper's licence (``REFITTED``) and under any other (``LEARNT``)."""
NOTES = (
    "Each warm-up meets the target on seed scenes that no table uses and {does}; the episodes that are counted "
    "start from the same seed scenes at every step. Intervals: bootstrap over warm-ups and scenes at once (Owen 2007, "
    "doi:10.1214/07-AOAS122), 95 %; Wilson before the first step, where there is one Q alone. "
    "All targets: the mean over them, a scene and the warm-ups of one number drawn together.",
)


def marks_of(steps: int) -> tuple[int, ...]:
    """Return the numbers of steps after which rates are measured: thirds of *steps*, by default 30, 60 and 90."""
    return tuple(sorted({max(1, round(steps * k / RUNGS)) for k in range(1, RUNGS + 1)}))


def plan_fewshot(
    folder: Folder, workers: int, limits: WorkerLimits, reporter: ProgressReporter
) -> BenchCells:
    """Run the warm-ups and return the cells of the request.

    Raises:
        InputError: a name is unknown, or the list of scenes cannot be used.
        EpisodeFailure: a warm-up fails.
    """
    request = folder.request
    scenes, names = resolve_fewshot_request(request, folder.path)
    results_folder = folder.path / "adapted"
    adaptations = {
        (guide, name, seed): _adaptation(guide, name, seed, folder)
        for guide in GUIDES
        for name in names
        for seed in range(request.seeds)
    }
    adapt(list(adaptations.values()), results_folder, workers, limits, reporter)
    licence = with_licence(PAPERS_LICENCE, request)
    cells = [_bench_cell(licence, guide, name, 0, 0) for guide in GUIDES for name in names]
    cells += [
        _bench_cell(licence, guide, name, seed, mark, adaptation.path(results_folder, mark))
        for (guide, name, seed), adaptation in adaptations.items()
        for mark in adaptation.marks
    ]
    return plan_cells(cells, scenes, request.horizon_s)


def _bench_cell(
    licence: Mapping[str, Any], guide: str, name: str, seed: int, mark: int, reward: Path | None = None
) -> BenchCell:
    options = {**licence, "guide": guide} | ({} if reward is None else {"reward": str(reward.resolve())})
    key, target = _row_key(guide, name, seed, mark), _unseen_target(name)
    return BenchCell(key, target.target, "diffusion", target.options, options, like=f"--guide {guide}")


def resolve_fewshot_request(
    request: Request, folder: Path | None = None
) -> tuple[SceneList, tuple[str, ...]]:
    """Return the seed scenes and targets of the request; *folder* of the bench once it is begun.

    Raises:
        InputError: a name is unknown, or the list of scenes cannot be used.
    """
    if request.policies:
        raise ConfigError("--policies: bench fewshot is of background diffusion alone; leave it out")
    scenes = bench_scenes(request.scenes, TABLE_LIST, folder)
    defaults = {name: unseen.target for name, unseen in UNSEEN.items()}
    names, _ = chosen_names(request.targets, defaults, TARGETS, "--targets", _make_unseen)
    return scenes, names


def fewshot_table(gathered: Gathered, scenes: SceneList, folder: Folder) -> Table:
    """Return the table: a row for each guide and target, a column for each number of steps."""
    request = folder.request
    marks = (0, *marks_of(request.steps))
    heads = tuple(Head(f"steps_{mark}", f"{mark} steps", "%", 100.0, 1, "high") for mark in marks)
    by_row = {cell.row: results for cell, results in gathered.finished.items()}
    names = tuple(dict.fromkeys(row.partition("/")[2].rsplit("/", 2)[0] for row in by_row))

    def ladder(guide: str, name: str) -> list[Pooled]:
        row_keys = [
            [_row_key(guide, name, seed, mark) for seed in range(request.seeds)] for mark in marks[1:]
        ]
        after_marks = [pooled_collisions([by_row[row] for row in rows]) for rows in row_keys]
        return [pooled_collisions([by_row[_row_key(guide, name, 0, 0)]]), *after_marks]

    rows: dict[tuple[str, str], list[Pooled]] = {}
    for guide in GUIDES:
        ladders = [ladder(guide, name) for name in names]
        rows |= {(guide, name): pooled_rates for name, pooled_rates in zip(names, ladders, strict=True)}
        if len(names) > 1:
            rows[guide, ALL] = [mean_over_targets(column) for column in zip(*ladders, strict=True)]
    lines = tuple(
        Line(f"{guide}/{name}", GUIDES[guide], name, _cells(heads, pooled_rates))
        for (guide, name), pooled_rates in rows.items()
    )
    gaps = tuple(
        Gap(f"{GUIDES[guide]}: {name}", head.key, head.title, "0 steps", rates.less(pooled_rates[0]))
        for (guide, name), pooled_rates in rows.items()
        for head, rates in zip(heads[1:], pooled_rates[1:], strict=True)
    )
    title = (
        f"Few-shot: collision rate after warm-up, {counted(request.seeds, 'warm-up')}, "
        f"{counted(len(scenes.scenes), 'seed scene')}, {request.horizon_s:g} s"
    )
    what_is_learnt = REFITTED if refits_q(request) else LEARNT
    notes = notes_of(gathered, scenes, folder, tuple(note.format(does=what_is_learnt) for note in NOTES))
    return Table("fewshot", title, heads, lines, gaps, notes)


def _row_key(guide: str, name: str, seed: int, mark: int) -> str:
    """Return the key of a row; only the name of a target may contain slashes."""
    return f"{guide}/{name}/{seed}/{mark}"


def _cells(heads: Sequence[Head], ladder: Sequence[Pooled]) -> dict[str, Cell]:
    return {head.key: Cell(rates.estimate()) for head, rates in zip(heads, ladder, strict=True)}


@dataclass(frozen=True)
class Pooled:
    """Collisions of several warm-ups on the same scenes.

    Attributes:
        scenes: keys of the S scenes that all of them finished.
        hits: (W, S) 1 where the target collided; of several targets, the share that collided.
        targets: number of targets.
    """

    scenes: tuple[str, ...]
    hits: FloatArray
    targets: int = 1

    def at(self, warm_ups: FloatArray, scenes: FloatArray) -> FloatArray:
        """Return the rates (R,) if warm-ups are drawn *warm_ups* (R, W) times and scenes *scenes* (R, S) times."""
        total = np.einsum("rw,ws,rs->r", warm_ups, self.hits, scenes)
        return np.asarray(total / (warm_ups.sum(1) * scenes.sum(1)))

    def estimate(self) -> Estimate:
        """Return the rate; with Wilson's interval if there is one warm-up or all trials have the same outcome."""
        if len(self.hits) == 1 and self.targets == 1:
            return estimate(Ratio(self.scenes, self.hits[0], np.ones(len(self.scenes)), rate=True))
        if not self.hits.size:
            return Estimate()
        value, scenes = float(self.hits.mean()), len(self.scenes)
        if value in (0.0, 1.0):  # drawing them again would show no spread
            low, high = wilson(round(value) * scenes, scenes)
        else:
            low, high = np.percentile(self.at(*_bootstrap_draws(self.hits.shape)), TAILS)
        return Estimate(value, float(low), float(high), self.targets * self.hits.size)

    def less(self, before: Pooled) -> Difference:
        """Return the difference of the rate to that of *before*; the same scenes are drawn for both."""
        position = {scene: k for k, scene in enumerate(before.scenes)}
        rows = [k for k, scene in enumerate(self.scenes) if scene in position]
        if not rows:
            return Difference()
        after = self._rows(np.array(rows))
        earlier = before._rows(np.array([position[self.scenes[k]] for k in rows]))
        warm_ups, scenes = _bootstrap_draws(after.hits.shape)
        ones = np.ones((len(scenes), len(earlier.hits)))
        interval = np.percentile(after.at(warm_ups, scenes) - earlier.at(ones, scenes), TAILS)
        low, high = widened_interval(float(interval[0]), float(interval[1]), len(rows))
        return Difference(float(after.hits.mean() - earlier.hits.mean()), low, high, None, len(rows))

    def _rows(self, rows: IntArray) -> Pooled:
        return Pooled(tuple(self.scenes[k] for k in rows.tolist()), self.hits[:, rows], self.targets)


def pooled_collisions(runs: Sequence[Sequence[EpisodeResult]]) -> Pooled:
    """Return the collisions of *runs* on the scenes that all of them finished."""
    flags = [{result.scene: float(bool(result.row["target_collision"])) for result in run} for run in runs]
    scenes = tuple(scene for scene in flags[0] if all(scene in by_scene for by_scene in flags))
    return Pooled(scenes, np.array([[by_scene[scene] for scene in scenes] for by_scene in flags]))


def mean_over_targets(parts: Sequence[Pooled]) -> Pooled:
    """Return the mean over targets, on the scenes that all of them finished; all have the same number of warm-ups."""
    common = [scene for scene in parts[0].scenes if all(scene in part.scenes for part in parts)]
    aligned_parts = [
        part._rows(np.array([part.scenes.index(scene) for scene in common], dtype=np.int64)) for part in parts
    ]
    return Pooled(
        tuple(common),
        np.mean([part.hits for part in aligned_parts], axis=0),
        sum(part.targets for part in parts),
    )


def _bootstrap_draws(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(0)
    counts = [rng.multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES).astype(np.float64) for n in shape]
    return counts[0], counts[1]


def _unseen_target(name: str) -> Unseen:
    return UNSEEN.get(name, Unseen(name))


def _make_unseen(name: str) -> object:
    return make_target(_unseen_target(name).target, _unseen_target(name).options)


def _adaptation(guide: str, name: str, seed: int, folder: Folder) -> Adaptation:
    request, unseen = folder.request, _unseen_target(name)
    options = {**with_licence(PAPERS_LICENCE, request), "guide": guide}
    return Adaptation(
        unseen.target, unseen.options, seed, marks_of(request.steps), request.horizon_s, options
    )
