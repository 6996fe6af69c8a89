"""``bench transfer``: the paper's third table: policies adapted to one planner meet others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.core.wording import counted
from advdiff_sumo.experiments.bench.adapt import Adaptation, adapt, surrogate_options
from advdiff_sumo.experiments.bench.adversarial import notes_of
from advdiff_sumo.experiments.bench.bench_config import Folder, Request, chosen_names
from advdiff_sumo.experiments.bench.bench_rows import (
    OURS,
    PAPERS_LICENCE,
    REGISTERED,
    TARGET_TITLES,
    made_target,
    policy_row,
    refits_q,
    resolve_request,
    with_licence,
)
from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells, plan_cells
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult, Gathered
from advdiff_sumo.experiments.bench.intervals import Estimate, Ratio, Sample, difference, draws
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.samples import background_samples, collision_samples
from advdiff_sumo.experiments.bench.scene_list import SceneList
from advdiff_sumo.experiments.bench.table import Gap, Head, RowSamples, Table, lines_of, paper_table
from advdiff_sumo.metrics.statistics import TAILS
from advdiff_sumo.planners.planner_registry import TARGETS
from advdiff_sumo.sweep.tasks import WorkerLimits

SOURCES = ("lane_graph", "simnet", "trafficsim")
"""Planners to which a policy is adapted: the paper's three."""
TARGETS_MET = {
    name: name for name in ("lane_graph", "simnet", "trafficsim", "diffusion", "IDM", "EIDM", "W99")
}
ADAPTED = ("advsim", "strive", "adv-rl", OURS)
BY_SURROGATE = ("advsim", "strive")
FIXED_SOURCE = {"adv-rl": "lane_graph"}
"""Policy → planner against which its shipped weights were trained (Adv-RL's against SUMO's IDM, too)."""
REFITTED = "Q warmed up against it (ours)"
LEARNT = "its failures learnt by a warm-up (ours; Q stays)"
"""How our method is adapted under the paper's licence (``REFITTED``) and under any other (``LEARNT``)."""
NOTES = (
    "A row is a policy and what it was adapted to: {ours}, expected as the target (AdvSim, Strive), or trained against "
    "(Adv-RL: the rule-based planner, and IDM). AV CR: share of episodes in which the target collides; BV CR: share of "
    "moved background vehicles that collide with another one or leave the road. Intervals: "
    "Wilson, 95 %.",
)


def plan_transfer(
    folder: Folder, workers: int, limits: WorkerLimits, reporter: ProgressReporter
) -> BenchCells:
    """Run the warm-ups and return the cells of the request.

    Raises:
        InputError: a name is unknown, or the list of scenes cannot be used.
        EpisodeFailure: a warm-up fails.
    """
    request = folder.request
    scenes, targets, names = resolve_transfer_request(request, reporter, folder.path)
    sources, _ = chosen_names((), {name: name for name in SOURCES}, TARGETS, "--targets", made_target)
    adapted_folder = folder.path / "adapted"
    if OURS in names:
        adapt([_warm_up(source, folder) for source in sources], adapted_folder, workers, limits, reporter)
    cells = [
        cell
        for name in names
        for source in sources
        if FIXED_SOURCE.get(name, source) == source
        for cell in _adapted_cells(name, source, targets, folder, adapted_folder)
    ]
    return plan_cells(cells, scenes, request.horizon_s)


def resolve_transfer_request(
    request: Request, reporter: ProgressReporter, folder: Path | None = None
) -> tuple[SceneList, tuple[str, ...], tuple[str, ...]]:
    """Return the seed scenes, targets and policies of the request; *folder* of the bench once it is begun.

    Raises:
        InputError: a name is unknown or cannot be adapted, or the list of scenes cannot be used.
    """
    adaptable_rows = {name: REGISTERED[name] for name in ADAPTED}
    scenes, targets, names = resolve_request(request, reporter, TARGETS_MET, adaptable_rows, folder=folder)
    if any(name not in ADAPTED for name in names):
        raise ConfigError(f"--policies: bench transfer has {', '.join(ADAPTED)}; only these can be adapted")
    return scenes, targets, names


def transfer_table(gathered: Gathered, scenes: SceneList, folder: Folder) -> Table:
    """Return the table: a row for each policy and source, two columns for each target."""
    targets = tuple(dict.fromkeys(cell.target for cell in gathered.finished))
    heads = tuple(head for target in targets for head in _heads(target))
    cells: dict[str, dict[str, Sample]] = {}
    for cell, results in gathered.finished.items():
        cells.setdefault(cell.row, {}).update(_samples(cell.target, results))
    rows = []
    for key, samples in cells.items():
        name, _, source = key.partition("/")
        title = policy_row(name).title.removesuffix(" (ours)")
        rows.append(RowSamples(key, "", f"{title} ← {TARGET_TITLES.get(source, source)}", samples))
    lines = lines_of(heads, rows, paper_table("transfer"))
    title = f"Transfer to other planners: {counted(len(scenes.scenes), 'seed scene')}, {folder.request.horizon_s:g} s"
    our_adaptation = REFITTED if refits_q(folder.request) else LEARNT
    definitions = (*kept_shares(rows), *(note.format(ours=our_adaptation) for note in NOTES))
    notes = notes_of(gathered, scenes, folder, definitions)
    return Table("transfer", title, heads, lines, _adaptation_gaps(rows), notes)


def _heads(target: str) -> tuple[Head, Head]:
    title = TARGET_TITLES.get(target, target)
    return (
        Head(f"{target}:av_rate", f"{title}: AV CR", "%", 100.0, 1, "high"),
        Head(f"{target}:bv_rate", f"{title}: BV CR", "%", 100.0, 2, "low"),
    )


def _samples(target: str, results: Sequence[EpisodeResult]) -> dict[str, Sample]:
    background = background_samples(results, ())
    samples: dict[str, Sample] = {f"{target}:av_rate": collision_samples(results)["collision_rate"]}
    env, veh = background.get("env_rate"), background.get("veh_rate")
    if isinstance(env, Ratio) and isinstance(veh, Ratio):
        collided_and_left = np.array([result.trace.both for result in results], dtype=np.float64)
        samples[f"{target}:bv_rate"] = Ratio(
            veh.scenes, env.total + veh.total - collided_and_left, veh.count, rate=True
        )
    return samples


def _warm_up(source: str, folder: Folder) -> Adaptation:
    request = folder.request
    licence = with_licence(PAPERS_LICENCE, request)
    return Adaptation(source, {}, 0, (request.steps,), request.horizon_s, licence)


def _adapted_cells(
    name: str, source: str, targets: Sequence[str], folder: Folder, adapted_folder: Path
) -> list[BenchCell]:
    """Return the cells of *name*, adapted to *source*, with each of *targets*."""
    options = with_licence(policy_row(name).options, folder.request)
    if name in BY_SURROGATE:
        options |= surrogate_options(source)
    if name == OURS:
        adapted = _warm_up(source, folder)
        options["reward"] = str(adapted.path(adapted_folder, folder.request.steps).resolve())
    background = policy_row(name).background
    key = f"{name}/{source}"
    return [BenchCell(key, target, background, background_options=options) for target in targets]


def _adaptation_gaps(rows: Sequence[RowSamples]) -> tuple[Gap, ...]:
    """Return, for each target that is also a source, the difference of adaptation to another planner to its own."""
    by_key = {row.key: row for row in rows}
    gaps = []
    for row in rows:
        name, _, source = row.key.partition("/")
        for target in SOURCES:
            own, column = by_key.get(f"{name}/{target}"), f"{target}:av_rate"
            if own is not None and target != source and column in row.samples and column in own.samples:
                change = difference(row.samples[column], own.samples[column])
                gaps.append(Gap(TARGET_TITLES.get(target, target), column, row.title, own.title, change))
    return tuple(gaps)


def kept_shares(rows: Sequence[RowSamples]) -> tuple[str, ...]:
    """Return sentences on the share of its collision rate that each policy keeps on targets it was not adapted to.

    The share is the rate on a target after adaptation to another one, divided by the rate after adaptation to it. Both
    are means over all such pairs, with a bootstrap over seed scenes.
    """
    by_key = {row.key: row for row in rows}
    sentences = []
    for name in dict.fromkeys(row.key.partition("/")[0] for row in rows):
        pairs = [
            (foreign.samples[f"{target}:av_rate"], own.samples[f"{target}:av_rate"])
            for target in SOURCES
            if (own := by_key.get(f"{name}/{target}")) is not None
            for source in SOURCES
            if source != target and (foreign := by_key.get(f"{name}/{source}")) is not None
            if f"{target}:av_rate" in own.samples and f"{target}:av_rate" in foreign.samples
        ]
        share = share_kept(pairs)
        if share.value is not None:
            interval = (
                "" if share.low is None else f" [{100 * share.low:.0f}, {100 * (share.high or 0.0):.0f}]"
            )
            title = policy_row(name).title
            sentences.append(
                f"{title} keeps {100 * share.value:.0f} %{interval} of its AV CR on planners it was not adapted to."
            )
    return tuple(sentences)


def share_kept(pairs: Sequence[tuple[Sample, Sample]]) -> Estimate:
    """Return Σ foreign rates / Σ own rates over the scenes that all samples have; empty if the own rates are 0."""
    samples = [sample for pair in pairs for sample in pair]
    if not samples:
        return Estimate()
    common = [scene for scene in samples[0].scenes if all(scene in sample.scenes for sample in samples)]
    if not common:
        return Estimate()
    rows_by_scene = [{scene: k for k, scene in enumerate(sample.scenes)} for sample in samples]
    aligned = [
        sample.rows(np.array([rows[s] for s in common]))
        for sample, rows in zip(samples, rows_by_scene, strict=True)
    ]

    def share(times: FloatArray) -> FloatArray:
        rates = [sample.at(times) for sample in aligned]
        foreign, own = np.sum(rates[::2], axis=0), np.sum(rates[1::2], axis=0)
        return np.asarray(np.where(own > 0.0, foreign / np.where(own > 0.0, own, 1.0), np.nan))

    value = float(share(np.ones((1, len(common))))[0])
    if np.isnan(value):
        return Estimate(n=len(common))
    resampled = share(draws(len(common)))
    low, high = np.nanpercentile(resampled, TAILS)
    return Estimate(value, float(low), float(high), len(common))
