"""``bench defects``: evaluates each background as a test by the planted defects that it detects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from advdiff_sumo.core.wording import counted, in_series
from advdiff_sumo.experiments.bench.adversarial import notes_of
from advdiff_sumo.experiments.bench.bench_config import Folder
from advdiff_sumo.experiments.bench.bench_rows import policy_row
from advdiff_sumo.experiments.bench.cells import BenchCells
from advdiff_sumo.experiments.bench.defect_cells import SOUND
from advdiff_sumo.experiments.bench.detection import (
    LEVEL,
    Detection,
    EpisodeOutcome,
    FirstDetection,
    SceneOutcomes,
    detections,
    first_detection,
    ranking_auc,
    too_few_scenes,
)
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult, Gathered
from advdiff_sumo.experiments.bench.finding_counts import findings_text, first_costs
from advdiff_sumo.experiments.bench.formatting import comma_separated
from advdiff_sumo.experiments.bench.intervals import Estimate, Ratio, difference, estimate, ratio
from advdiff_sumo.experiments.bench.table import Cell, Gap, Head, Line, Table
from advdiff_sumo.sweep.sweep_files import write_whole

DETECTIONS, FIRST, BY_STRATUM = "detections.csv", "first_detection.csv", "by_stratum.csv"
FINDINGS = "findings.csv"
COUNTS = ("scenes", "failures", "sound_failures", "only_defect", "only_sound")
RULE_COLUMNS = ("broke_rule", "sound_broke_rule", "rules_p_holm", "detected_by_rules")
SCORE = "detected / planted"
NOTES = (
    "Cells: share of episodes that end in a valid failure of the target, 95 % Wilson interval. Bold: detected, the "
    "defect's valid failures exceed the sound target's on the same seed scenes (exact McNemar, one-sided, p < "
    f"{LEVEL:g} after Holm over the defects). Rows 'sound': false alarms. Below: defects less sound, with that p, "
    "where they differ.",
)


@dataclass(frozen=True)
class Contest:
    """One target with one background.

    Attributes:
        background: key of the background's row.
        target: as registered.
        sound: outcomes of the sound target.
        defective: outcomes with each defect, by its name.
        detections: the test of each defect, by valid failures.
        rule_detections: the same by the rules that the target broke, with or without a collision.
        first: effort until the first detection; None if no defect is detected.
        auc: how well valid failures rank the target with a defect above the sound targets with this background,
            including ``careful``; None without a defect.
    """

    background: str
    target: str
    sound: SceneOutcomes
    defective: Mapping[str, SceneOutcomes]
    detections: tuple[Detection, ...]
    rule_detections: tuple[Detection, ...]
    first: FirstDetection | None
    auc: float | None


def defects_of(gathered: Gathered, cells: BenchCells, folder: Folder) -> Table:
    """Write the files of detections and findings, and return the table.

    Raises:
        FileError: it cannot be written.
    """
    contests = contests_of(gathered, cells)
    write_whole(folder.path / DETECTIONS, detections_text(contests).encode())
    write_whole(folder.path / FIRST, first_text(contests).encode())
    write_whole(folder.path / BY_STRATUM, by_stratum_text(contests, cells).encode())
    by_key = {(contest.background, contest.target): contest for contest in contests}
    costs = {key: first_costs(contest.sound, contest.defective) for key, contest in by_key.items()}
    aucs = {key: contest.auc for key, contest in by_key.items()}
    write_whole(folder.path / FINDINGS, findings_text(gathered, costs, aucs).encode())
    return defects_table(contests, gathered, cells, folder)


def contests_of(gathered: Gathered, cells: BenchCells) -> tuple[Contest, ...]:
    """Return the contest of each target and background, in the order of the cells."""
    order = scene_order(cells)
    by_cell: dict[tuple[str, str], dict[str, SceneOutcomes]] = {}
    for cell, episodes in gathered.finished.items():
        outcomes = _scene_outcomes(episodes, order)
        by_cell.setdefault((cell.row, cell.target), {})[cell.defect] = outcomes
    sound_shares: dict[str, list[float]] = {}
    for (background, _), by_defect in by_cell.items():
        sound_shares.setdefault(background, []).extend(_failure_shares([by_defect[SOUND]]))
    contests = []
    for (background, target), by_defect in by_cell.items():
        sound = by_defect.pop(SOUND)
        detected, first = detections(sound, by_defect), first_detection(sound, by_defect)
        auc = ranking_auc(sound_shares[background], _failure_shares(by_defect.values()))
        by_rules = detections(sound, by_defect, "broke_rule")
        contests.append(Contest(background, target, sound, by_defect, detected, by_rules, first, auc))
    return tuple(contests)


def scene_order(cells: BenchCells) -> Mapping[str, int]:
    """Return seed scene's key → its position in the list, in which nets and strata take turns."""
    positions = {scene.place: k for k, scene in enumerate(cells.scenes.scenes)}
    groups = list(cells.scenes.counts())
    jobs = cells.plan.jobs
    return {job.scene_key: positions[(*groups[job.cell % len(groups)], job.number)] for job in jobs}


def defects_table(
    contests: tuple[Contest, ...], gathered: Gathered, cells: BenchCells, folder: Folder
) -> Table:
    """Return the table with a column for each background and a row for each defect."""
    names = tuple(dict.fromkeys(contest.background for contest in contests))
    heads = tuple(Head(name, policy_row(name).title, "%", 100.0, 1) for name in names)
    lines: list[Line] = []
    for target in dict.fromkeys(contest.target for contest in contests):
        by_row = {contest.background: contest for contest in contests if contest.target == target}
        lines.append(_sound_line(target, by_row))
        defects = dict.fromkeys(name for contest in by_row.values() for name in contest.defective)
        lines += [_defect_line(target, defect, by_row) for defect in defects]
        if defects:
            lines.append(_score_line(target, by_row))
    scenes = cells.scenes
    title = f"Planted defects: {counted(len(scenes.scenes), 'seed scene')}, {folder.request.horizon_s:g} s"
    sentences = tuple(
        _first_note(each) + _rank_note(each.auc) + _rules_note(each) for each in contests if each.defective
    )
    planted_count = {contest.target: len(contest.detections) for contest in contests}
    warnings = (too_few_scenes(len(scenes.scenes), target, count) for target, count in planted_count.items())
    sentences = (*sentences, *(sentence for sentence in warnings if sentence))
    notes = (*NOTES, *sentences, *_source_note(folder), *notes_of(gathered, scenes, folder, ()))
    return Table("defects", title, heads, tuple(lines), _gaps(contests), notes)


def detections_text(contests: tuple[Contest, ...]) -> str:
    """Return a CSV line for each defect, target and background: counts and test, also those of broken rules."""
    rows = []
    for contest in contests:
        for detection, by_rules in zip(contest.detections, contest.rule_detections, strict=True):
            numbers = (getattr(detection, name) for name in COUNTS)
            test = (f"{detection.p:.6g}", f"{detection.adjusted:.6g}", str(detection.detected).lower())
            broke = (by_rules.failures, by_rules.sound_failures, f"{by_rules.adjusted:.6g}")
            rule_test = (*broke, str(by_rules.detected).lower())
            rows.append((contest.background, contest.target, detection.defect, *numbers, *test, *rule_test))
    names = ("background", "target", "defect", *COUNTS, "p", "p_holm", "detected", *RULE_COLUMNS)
    return comma_separated(names, rows)


def first_text(contests: tuple[Contest, ...]) -> str:
    """Return a CSV line for each target and background: cost of its first detection; CPU times vary by machine."""
    names = (
        "background",
        "target",
        "detected",
        "planted",
        "first",
        "scenes",
        "episodes",
        "cpu_s",
        "all_cpu_s",
    )
    rows = []
    for contest in contests:
        if not contest.defective:
            continue
        detected = sum(detection.detected for detection in contest.detections)
        planners = (contest.sound, *contest.defective.values())
        outcomes = [outcome for planner in planners for outcome in planner.values()]
        total_cpu_s = sum(outcome.cpu_s for outcome in outcomes)
        first = contest.first
        cost = ("", "", "", "")
        if first is not None:
            cost = (" ".join(first.defects), str(first.scenes), str(first.episodes), f"{first.cpu_s:.1f}")
        planted = len(contest.detections)
        rows.append((contest.background, contest.target, detected, planted, *cost, f"{total_cpu_s:.1f}"))
    return comma_separated(names, rows)


def by_stratum_text(contests: tuple[Contest, ...], cells: BenchCells) -> str:
    """Return a CSV line for each background, target, defect, net and stratum of seed scenes: its valid failures."""
    scenes = cells.scenes.scenes
    strata = {key: (scenes[k].net, scenes[k].stratum) for key, k in scene_order(cells).items()}
    rows = []
    for contest in contests:
        for defect, outcomes in ((SOUND, contest.sound), *contest.defective.items()):
            for part in dict.fromkeys(strata[scene] for scene in outcomes):
                failed = [outcome.failed for scene, outcome in outcomes.items() if strata[scene] == part]
                rows.append((contest.background, contest.target, defect, *part, len(failed), sum(failed)))
    names = ("background", "target", "defect", "net", "stratum", "scenes", "failures")
    return comma_separated(names, rows)


def _scene_outcomes(episodes: list[EpisodeResult], order: Mapping[str, int]) -> SceneOutcomes:
    ordered = sorted(episodes, key=lambda result: order[result.scene])
    return {result.scene: EpisodeOutcome.of(result.row, result.cpu_s) for result in ordered}


def _failure_shares(planners: Iterable[SceneOutcomes]) -> list[float]:
    """Return the share of valid failures of each planner with finished episodes."""
    flags = [[outcome.failed for outcome in planner.values()] for planner in planners if planner]
    return [sum(failed) / len(failed) for failed in flags]


def _rate(outcomes: SceneOutcomes) -> Ratio:
    flags = [float(outcome.failed) for outcome in outcomes.values()]
    return ratio(list(outcomes), flags, [1.0] * len(outcomes), rate=True)


def _sound_line(target: str, by_background: Mapping[str, Contest]) -> Line:
    cells = {name: Cell(estimate(_rate(contest.sound))) for name, contest in by_background.items()}
    return Line(SOUND, target, SOUND, cells, reference=True)


def _defect_line(target: str, defect: str, by_background: Mapping[str, Contest]) -> Line:
    cells = {}
    for name, contest in by_background.items():
        if defect in contest.defective:
            detected = any(test.detected for test in contest.detections if test.defect == defect)
            cells[name] = Cell(estimate(_rate(contest.defective[defect])), best=detected)
    return Line(defect, target, defect, cells)


def _score_line(target: str, by_background: Mapping[str, Contest]) -> Line:
    cells = {}
    for name, contest in by_background.items():
        share = sum(detection.detected for detection in contest.detections) / len(contest.detections)
        cells[name] = Cell(Estimate(share, n=len(contest.detections)))
    return Line("score", target, SCORE, cells)


def _gaps(contests: tuple[Contest, ...]) -> tuple[Gap, ...]:
    gaps = []
    for contest in contests:
        for detection in contest.detections:
            if detection.only_defect or detection.only_sound:
                change = difference(_rate(contest.defective[detection.defect]), _rate(contest.sound))
                change = replace(change, p=detection.adjusted)
                gaps.append(Gap(contest.target, contest.background, detection.defect, SOUND, change))
    return tuple(gaps)


def _first_note(contest: Contest) -> str:
    detected = sum(detection.detected for detection in contest.detections)
    title, planted = policy_row(contest.background).title, len(contest.detections)
    sentence = f"{title} detects {detected} of {planted} in {contest.target}"
    first = contest.first
    if first is None:
        return f"{sentence}."
    names = in_series(first.defects)
    effort = f"{counted(first.scenes, 'scene')}, {counted(first.episodes, 'episode')}"
    return f"{sentence}; the first, {names}, after {effort}."


def _source_note(folder: Folder) -> tuple[str, ...]:
    """Return a note on the seed scenes of a request with nets, named as for ``run``."""
    request = folder.request
    if not request.nets:
        return ()
    in_turn = " in turn" if len(request.nets) > 1 else ""
    seed = request.episode.seed
    return (f"Seed scenes: the first {request.scenes} of {', '.join(request.nets)}{in_turn}, seed {seed}.",)


def _rank_note(auc: float | None) -> str:
    return "" if auc is None else f" Its valid failures rank defective above sound planners: AUC {auc:.3f}."


def _rules_note(contest: Contest) -> str:
    """Return which defects show in broken rules only, by the same test as valid failures."""
    names = [
        f"{by_rules.defect} ({by_rules.failures} of {by_rules.scenes}, sound {by_rules.sound_failures})"
        for by_failures, by_rules in zip(contest.detections, contest.rule_detections, strict=True)
        if by_rules.detected and not by_failures.detected
    ]
    return f" Only rules broken without a collision reveal {in_series(names)}." if names else ""
