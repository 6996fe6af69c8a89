"""``bench defects``: what each background is worth as a test, in planted defects that it detects."""

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
    Tried,
    detections,
    first_detection,
    ranking_auc,
    too_few,
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
SCORE = "detected / planted"
NOTES = (
    "Cells: share of episodes that end in a valid failure of the target, 95 % Wilson interval. Bold: detected, the "
    "defect's valid failures exceed the sound target's on the same seed scenes (exact McNemar, one-sided, p < "
    f"{LEVEL:g} after Holm over the defects). Rows 'sound': false alarms. Below: defects less sound, with that p, "
    "where they differ.",
)


@dataclass(frozen=True)
class Contest:
    """One target before one background.

    Attributes:
        background: key of the background's row.
        target: as registered.
        sound: what the sound target came to.
        defective: the same with each defect, by its name.
        detections: what is detected.
        first: after how much; None where nothing is.
        auc: how well valid failures rank the target with a defect above the sound targets before this background,
            ``careful`` among them; None without a defect.
    """

    background: str
    target: str
    sound: Tried
    defective: Mapping[str, Tried]
    detections: tuple[Detection, ...]
    first: FirstDetection | None
    auc: float | None


def defects_of(gathered: Gathered, cells: BenchCells, folder: Folder) -> Table:
    """Write what is detected, and return the table.

    Raises:
        FileError: it cannot be written.
    """
    contests = contests_of(gathered, cells)
    write_whole(folder.path / DETECTIONS, detections_text(contests).encode())
    write_whole(folder.path / FIRST, first_text(contests).encode())
    write_whole(folder.path / BY_STRATUM, by_stratum_text(contests, cells).encode())
    costs = {(one.background, one.target): first_costs(one.sound, one.defective) for one in contests}
    ranked = {(one.background, one.target): one.auc for one in contests}
    write_whole(folder.path / FINDINGS, findings_text(gathered, costs, ranked).encode())
    return defects_table(contests, gathered, cells, folder)


def contests_of(gathered: Gathered, cells: BenchCells) -> tuple[Contest, ...]:
    """Return each target before each background, in the order of the cells."""
    order = scene_order(cells)
    tried: dict[tuple[str, str], dict[str, Tried]] = {}
    for cell, episodes in gathered.finished.items():
        tried.setdefault((cell.row, cell.target), {})[cell.defect] = _tried(episodes, order)
    sound_shares: dict[str, list[float]] = {}
    for (background, _), by_defect in tried.items():
        sound_shares.setdefault(background, []).extend(_shares([by_defect[SOUND]]))
    contests = []
    for (background, target), by_defect in tried.items():
        sound = by_defect.pop(SOUND)
        detected, first = detections(sound, by_defect), first_detection(sound, by_defect)
        auc = ranking_auc(sound_shares[background], _shares(by_defect.values()))
        contests.append(Contest(background, target, sound, by_defect, detected, first, auc))
    return tuple(contests)


def scene_order(cells: BenchCells) -> Mapping[str, int]:
    """Return the place of each seed scene, by its key, in the list, in which nets and strata take turns."""
    places = {scene.place: k for k, scene in enumerate(cells.scenes.scenes)}
    runs = list(cells.scenes.counts())
    return {job.scene_key: places[(*runs[job.cell % len(runs)], job.number)] for job in cells.plan.jobs}


def defects_table(
    contests: tuple[Contest, ...], gathered: Gathered, cells: BenchCells, folder: Folder
) -> Table:
    """Return the table: a column a background, a row a defect."""
    names = tuple(dict.fromkeys(contest.background for contest in contests))
    heads = tuple(Head(name, policy_row(name).title, "%", 100.0, 1) for name in names)
    lines: list[Line] = []
    for target in dict.fromkeys(contest.target for contest in contests):
        here = {contest.background: contest for contest in contests if contest.target == target}
        lines.append(_sound_line(target, here))
        defects = tuple(dict.fromkeys(name for contest in here.values() for name in contest.defective))
        lines += [_defect_line(target, defect, here) for defect in defects]
        if defects:
            lines.append(_score_line(target, here))
    scenes = cells.scenes
    title = f"Planted defects: {counted(len(scenes.scenes), 'seed scene')}, {folder.request.horizon_s:g} s"
    firsts = tuple(_first_note(one) + _rank_note(one.auc) for one in contests if one.defective)
    planted = {one.target: len(one.detections) for one in contests}
    lacking = (too_few(len(scenes.scenes), target, count) for target, count in planted.items())
    firsts = (*firsts, *(sentence for sentence in lacking if sentence))
    notes = (*NOTES, *firsts, *_source_note(folder), *notes_of(gathered, scenes, folder, ()))
    return Table("defects", title, heads, tuple(lines), _gaps(contests), notes)


def detections_text(contests: tuple[Contest, ...]) -> str:
    """Return one line a defect, target and background: what was counted and how it was tested."""
    rows = []
    for contest in contests:
        for one in contest.detections:
            numbers = (getattr(one, name) for name in COUNTS)
            tested = (f"{one.p:.6g}", f"{one.adjusted:.6g}", str(one.detected).lower())
            rows.append((contest.background, contest.target, one.defect, *numbers, *tested))
    return comma_separated(("background", "target", "defect", *COUNTS, "p", "p_holm", "detected"), rows)


def first_text(contests: tuple[Contest, ...]) -> str:
    """Return one line a target and background: what its first detection cost; the seconds differ between machines."""
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
        detected = sum(one.detected for one in contest.detections)
        every = sum(one.cpu_s for x in (contest.sound, *contest.defective.values()) for one in x.values())
        first = contest.first
        cost = ("", "", "", "")
        if first is not None:
            cost = (" ".join(first.defects), str(first.scenes), str(first.episodes), f"{first.cpu_s:.1f}")
        planted = len(contest.detections)
        rows.append((contest.background, contest.target, detected, planted, *cost, f"{every:.1f}"))
    return comma_separated(names, rows)


def by_stratum_text(contests: tuple[Contest, ...], cells: BenchCells) -> str:
    """Return one line a net, stratum of the seed scenes, defect, target and background: its valid failures."""
    listed = cells.scenes.scenes
    parts = {key: (listed[place].net, listed[place].stratum) for key, place in scene_order(cells).items()}
    rows = []
    for contest in contests:
        for defect, tried in ((SOUND, contest.sound), *contest.defective.items()):
            for part in dict.fromkeys(parts[scene] for scene in tried):
                failed = [one.failed for scene, one in tried.items() if parts[scene] == part]
                rows.append((contest.background, contest.target, defect, *part, len(failed), sum(failed)))
    names = ("background", "target", "defect", "net", "stratum", "scenes", "failures")
    return comma_separated(names, rows)


def _tried(episodes: list[EpisodeResult], order: Mapping[str, int]) -> Tried:
    ranked = sorted(episodes, key=lambda one: order[one.scene])
    return {one.scene: EpisodeOutcome.of(one.row, one.cpu_s) for one in ranked}


def _shares(some: Iterable[Tried]) -> list[float]:
    """Return how often each failed; one of which no episode finished has no share."""
    return [sum(one.failed for one in tried.values()) / len(tried) for tried in some if tried]


def _rate(tried: Tried) -> Ratio:
    return ratio(list(tried), [float(one.failed) for one in tried.values()], [1.0] * len(tried), rate=True)


def _sound_line(target: str, here: Mapping[str, Contest]) -> Line:
    cells = {name: Cell(estimate(_rate(contest.sound))) for name, contest in here.items()}
    return Line(SOUND, target, SOUND, cells, reference=True)


def _defect_line(target: str, defect: str, here: Mapping[str, Contest]) -> Line:
    cells = {}
    for name, contest in here.items():
        if defect in contest.defective:
            detected = any(one.detected for one in contest.detections if one.defect == defect)
            cells[name] = Cell(estimate(_rate(contest.defective[defect])), best=detected)
    return Line(defect, target, defect, cells)


def _score_line(target: str, here: Mapping[str, Contest]) -> Line:
    cells = {}
    for name, contest in here.items():
        share = sum(one.detected for one in contest.detections) / len(contest.detections)
        cells[name] = Cell(Estimate(share, n=len(contest.detections)))
    return Line("score", target, SCORE, cells)


def _gaps(contests: tuple[Contest, ...]) -> tuple[Gap, ...]:
    gaps = []
    for contest in contests:
        for one in contest.detections:
            if one.only_defect or one.only_sound:
                change = difference(_rate(contest.defective[one.defect]), _rate(contest.sound))
                change = replace(change, p=one.adjusted)
                gaps.append(Gap(contest.target, contest.background, one.defect, SOUND, change))
    return tuple(gaps)


def _first_note(contest: Contest) -> str:
    detected = sum(one.detected for one in contest.detections)
    title, planted = policy_row(contest.background).title, len(contest.detections)
    sentence = f"{title} detects {detected} of {planted} in {contest.target}"
    first = contest.first
    if first is None:
        return f"{sentence}."
    names = in_series(first.defects)
    tried = f"{counted(first.scenes, 'scene')}, {counted(first.episodes, 'episode')}"
    return f"{sentence}; the first, {names}, after {tried}."


def _source_note(folder: Folder) -> tuple[str, ...]:
    """Return which seed scenes those of nets are, in the words of ``run``."""
    request = folder.request
    if not request.nets:
        return ()
    turns = " in turn" if len(request.nets) > 1 else ""
    seed = request.episode.seed
    return (f"Seed scenes: the first {request.scenes} of {', '.join(request.nets)}{turns}, seed {seed}.",)


def _rank_note(auc: float | None) -> str:
    return "" if auc is None else f" Its valid failures rank defective above sound planners: AUC {auc:.3f}."
