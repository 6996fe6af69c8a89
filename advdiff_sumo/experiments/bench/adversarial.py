"""``bench adversarial``: the paper's second table, in closed loop, with four columns more."""

from __future__ import annotations

from importlib.metadata import version

from advdiff_sumo.core.wording import counted
from advdiff_sumo.experiments.bench.bench_config import Folder
from advdiff_sumo.experiments.bench.bench_rows import (
    NATURAL,
    OURS,
    policy_row,
    resolve_request,
    with_licence,
)
from advdiff_sumo.experiments.bench.cells import BenchCell, BenchCells, plan_cells
from advdiff_sumo.experiments.bench.episode_results import Gathered, failures_sentence
from advdiff_sumo.experiments.bench.reporter import ProgressReporter
from advdiff_sumo.experiments.bench.samples import background_samples, collision_samples
from advdiff_sumo.experiments.bench.scene_list import SceneList
from advdiff_sumo.experiments.bench.table import Head, RowSamples, Table, gaps_of, lines_of, paper_table

PLAN_NOTHING = ("sumo", "replay")
ATTACKED = {"lane_graph": "lane_graph", "IDM": "IDM"}
HEADS = (
    Head("collision_rate", "CR", "%", 100.0, 1, "high"),
    Head("collision_mps", "coll. speed", "m/s", digits=2, better="high"),
    Head("accel_mps2", "acc.", "m/s²", digits=2, better="high"),
    Head("jerk_mps3", "jerk", "m/s³", digits=2, better="high"),
    Head("jsd", "BV JSD", "10⁻²", 100.0, 2, "low"),
    Head("env_rate", "env. coll.", "%", 100.0, 2, "low"),
    Head("veh_rate", "veh. coll.", "%", 100.0, 2, "low"),
    Head("hz", "plans", "Hz", digits=1, measured=True),
    Head("fault_rate", "at fault", "%", 100.0, 1, "high"),
    Head("solvable_rate", "solvable", "%", 100.0, 1, "high"),
    Head("seen_rate", "seen", "%", 100.0, 1, "high"),
    Head("nats", "log-lik.", "nats/s", digits=2, better="high"),
)
NOTES = (
    "Columns as in the paper's Sec. IV, Metrics; docs/benches.md defines each. Intervals: Wilson for rates, bootstrap "
    "over seed scenes for the rest; 95 %. n: episodes for CR, collisions for coll. speed, at fault, solvable and seen, "
    "vehicles for env. and veh. coll., values for JSD, vehicle-seconds for log-lik.",
    "JSD is against SUMO's natural traffic from the same seed scenes. The paper's figures are of nuScenes logs.",
)


def plan_adversarial(folder: Folder, reporter: ProgressReporter) -> BenchCells:
    """Return the cells of the request.

    Raises:
        InputError: a name is unknown, or the list of scenes cannot be used.
    """
    request = folder.request
    scenes, targets, names = resolve_request(request, reporter, ATTACKED, folder=folder.path)
    rows = {name: policy_row(name) for name in names}
    options = {name: with_licence(row.options, request) for name, row in rows.items()}
    cells = [
        BenchCell(name, target, rows[name].background, background_options=options[name])
        for target in targets
        for name in names
    ]
    return plan_cells(cells, scenes, request.horizon_s)


def adversarial_table(results: Gathered, scenes: SceneList, folder: Folder) -> Table:
    """Return the table of the episodes."""
    natural = {cell.target: episodes for cell, episodes in results.finished.items() if cell.row == NATURAL}
    rows = []
    for cell, episodes in results.finished.items():
        policy = policy_row(cell.row)
        samples = collision_samples(episodes) | background_samples(
            episodes, natural.get(cell.target, ()), plans=cell.background not in PLAN_NOTHING
        )
        is_ours = cell.row == OURS
        rows.append(RowSamples(cell.row, cell.target, policy.title, samples, policy.reference, is_ours))
    lines = lines_of(HEADS, rows, paper_table("adversarial"))
    heads = tuple(head for head in HEADS if any(head.key in line.cells for line in lines))
    scene_count = counted(len(scenes.scenes), "seed scene")
    title = f"Adversarial traffic, closed loop: {scene_count}, {folder.request.horizon_s:g} s"
    return Table(
        "adversarial", title, heads, lines, gaps_of(heads, rows), notes_of(results, scenes, folder, NOTES)
    )


def notes_of(
    results: Gathered, scenes: SceneList, folder: Folder, definitions: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the notes of a closed-loop table: definitions, failed episodes, seed scenes, licence and revisions."""
    failures = failures_sentence(results, results.finished)
    differs = scenes.sumo != version("libsumo") or scenes.horizon_s != folder.request.horizon_s
    differs = differs and not scenes.log
    difference = (
        f"The list of seed scenes is for SUMO {scenes.sumo} and episodes of {scenes.horizon_s:g} s: these are others, "
        "from the same seeds."
        if differs
        else ""
    )
    scenes_note = (
        f"Seed scenes: sha256 {scenes.sha256[:16]}. Revision: {', '.join(r[:10] for r in folder.revisions)}."
    )
    licence = f"Licence: {folder.request.licence}." if folder.request.licence else ""
    log_note = "Seed scenes are of a driving log, one a second of every drive." if scenes.log else ""
    return tuple(
        note for note in (*definitions, failures, difference, log_note, licence, scenes_note) if note
    )
