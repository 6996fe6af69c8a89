"""What counts as detected, worked by hand, and what of a bench of defects is written."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.errors import ConfigError, UnknownNameError
from advdiff_sumo.experiments.bench.bench_config import Folder, Request
from advdiff_sumo.experiments.bench.bench_figure import draw
from advdiff_sumo.experiments.bench.defect_cells import SOUND, plan_defects, planted_defects
from advdiff_sumo.experiments.bench.defect_score import (
    by_stratum_text,
    contests_of,
    defects_table,
    detections_text,
    first_text,
    scene_order,
)
from advdiff_sumo.experiments.bench.detection import (
    EpisodeOutcome,
    SceneOutcomes,
    detections,
    first_detection,
    least_scenes,
    ranking_auc,
    too_few_scenes,
)
from advdiff_sumo.experiments.bench.episode_results import EpisodeResult, Gathered
from advdiff_sumo.experiments.bench.reporter import Silent
from advdiff_sumo.experiments.bench.traces import UNTRACED
from advdiff_sumo.experiments.bench.write_table import markdown_text
from advdiff_sumo.metrics.statistics import holm, mcnemar_more

REQUEST = Request(
    bench="defects",
    scenes="12",
    policies=("sumo", "replay"),
    targets=("lane_graph",),
    defects=("late", "range:20"),
)


def tried(failed: str) -> SceneOutcomes:
    """Return outcomes of scenes 0, 1, …: x for a valid failure, a second each."""
    return {f"s{k}": EpisodeOutcome(letter == "x", 1.0) for k, letter in enumerate(failed)}


def test_one_sided_mcnemar_by_hand() -> None:
    """Five against one: (C(6,5) + C(6,6)) / 2⁶; the other way round all but that of none."""
    assert mcnemar_more(5, 1) == pytest.approx(7 / 64)
    assert mcnemar_more(1, 5) == pytest.approx(63 / 64)
    assert mcnemar_more(0, 0) == 1.0


def test_holm_by_hand() -> None:
    """Of three: the least × 3, the next × 2, the last × 1, never less than the one before."""
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.6, 0.01]) == pytest.approx([0.6, 0.02])
    assert holm([]) == []


@given(st.lists(st.floats(0.0, 1.0), max_size=8))
def test_holm_lies_between_the_values_and_bonferroni(p_values: list[float]) -> None:
    for p, adjusted in zip(p_values, holm(p_values), strict=True):
        assert p <= adjusted <= min(len(p_values) * p, 1.0) + 1e-12 or adjusted == max(holm(p_values))
    assert sorted(range(len(p_values)), key=lambda k: (p_values[k], k)) == sorted(
        range(len(p_values)), key=lambda k: (holm(p_values)[k], p_values[k], k)
    )


def test_five_failures_that_the_sound_one_does_not_share_are_detected_alone_but_not_of_two() -> None:
    """1 / 2⁵ = 0.031 alone; twice that beside another defect."""
    sound, shown, hidden = tried("........"), tried("x.xxxx.."), tried(".......x")
    (alone,) = detections(sound, {"late": shown})
    assert (alone.p, alone.adjusted, alone.detected) == (1 / 32, 1 / 32, True)
    of_two = detections(sound, {"late": shown, "range": hidden})
    assert [(one.failures, one.adjusted, one.detected) for one in of_two] == [
        (5, 1 / 16, False),
        (1, 0.5, False),
    ]


def test_a_false_alarm_counts_against_and_scenes_that_one_lacks_do_not_count() -> None:
    sound, shown = tried("x......."), {k: v for k, v in tried(".xxxxx..").items() if k != "s5"}
    (one,) = detections(sound, {"late": shown})
    assert (one.scenes, one.failures, one.sound_failures, one.only_defect, one.only_sound) == (7, 4, 1, 4, 1)
    assert one.p == pytest.approx(6 / 32)


def test_the_first_detection_counts_what_was_tried_until_then() -> None:
    """The fifth failure comes in the seventh scene: 7 scenes of the sound target and of two defects, a second each."""
    sound, shown, other = tried("." * 10), tried("x.xx.xxxxx"), tried("." * 10)
    first = first_detection(sound, {"late": shown})
    assert first is not None
    assert (first.defects, first.scenes, first.episodes, first.cpu_s) == (("late",), 7, 14, 14.0)
    both = first_detection(sound, {"late": shown, "range": other})  # six are needed: 2 / 2⁶
    assert both is not None
    assert (both.scenes, both.episodes) == (8, 24)
    assert first_detection(sound, {"range": other}) is None


@pytest.mark.parametrize(("planted", "least"), [(1, 5), (2, 6), (3, 6), (4, 7), (22, 9), (25, 9), (26, 10)])
def test_the_least_number_of_scenes_by_hand(planted: int, least: int) -> None:
    """The least n with planted / 2ⁿ < 0.05: 1/32, 2/64, 3/64, 4/128, 22/512, 25/512; 26/512 = 0.0508 is not."""
    assert least_scenes(planted) == least
    for scenes, seen in ((least, True), (least - 1, False)):
        sound, shown = tried("." * scenes), tried("x" * scenes)
        one, *_ = detections(sound, {f"d{k}": shown for k in range(planted)})
        assert one.detected is seen


def test_too_few_scenes_are_told_with_the_number_that_would_do() -> None:
    """Of three scenes the p of two defects is 2 / 2³, of one 1 / 2³; none planted, none to detect."""
    assert too_few_scenes(3, "av:AV", 2).startswith(
        "3 seed scenes are too few to detect any of the 2 defects planted in av:AV,"
    )
    assert "p = 0.25 after Holm's correction" in too_few_scenes(3, "av:AV", 2)
    assert too_few_scenes(3, "av:AV", 2).endswith(" 6 would be enough for that.")
    assert too_few_scenes(1, "av:AV", 1).startswith(
        "1 seed scene is too few to detect the defect planted in av:AV,"
    )
    assert (
        too_few_scenes(6, "av:AV", 2),
        too_few_scenes(5, "av:AV", 1),
        too_few_scenes(1, "careful", 0),
    ) == ("", "", "")
    assert too_few_scenes(5, "av:AV", 2)


# --- the bench --------------------------------------------------------------------------------------------


def gathered(
    folder: Folder, fails: dict[tuple[str, str], int], breaks: dict[tuple[str, str], int] | None = None
) -> tuple[Gathered, object]:
    """Return what a sweep would have given: each cell fails, or runs a red light, in the first so many scenes."""
    cells = plan_defects(folder, Silent())
    order, found = scene_order(cells), Gathered()
    for cell, job in cells.jobs():
        failed = order[job.scene_key] < fails.get((cell.row, cell.defect), 0)
        row = {
            "target_collision": failed,
            "valid_failure": failed,
            "end": "collision" if failed else "horizon",
            "offences": "red_light" * (order[job.scene_key] < (breaks or {}).get((cell.row, cell.defect), 0)),
        }
        found.finished.setdefault(cell, []).append(EpisodeResult(job.scene_key, row, UNTRACED, None, 2.0))
    return found, cells


def test_cells_are_paired_and_ordered_and_their_table_says_what_is_detected(tmp_path: Path) -> None:
    folder = Folder(tmp_path, REQUEST)
    found, cells = gathered(
        folder, {("sumo", "late:strong"): 8, ("replay", SOUND): 3, ("replay", "range:middle"): 3}
    )
    contests = [one for one in contests_of(found, cells) if one.target == "lane_graph"]  # type: ignore[arg-type] # the cells
    assert [(one.background, list(one.defective)) for one in contests] == [
        ("sumo", ["late:strong", "range:middle"]),
        ("replay", ["late:strong", "range:middle"]),
    ]
    rows = list(csv.DictReader(io.StringIO(detections_text(tuple(contests)))))
    assert [row["detected"] for row in rows] == ["true", "false", "false", "false"]
    assert float(rows[0]["p_holm"]) == pytest.approx(2 / 2**8, rel=1e-5)
    (first, second) = csv.DictReader(io.StringIO(first_text(tuple(contests))))
    assert (first["detected"], first["planted"], first["first"]) == ("1", "2", "late:strong")
    assert (first["scenes"], first["episodes"], first["cpu_s"], first["all_cpu_s"]) == (
        "6",
        "18",
        "36.0",
        "72.0",
    )
    assert (second["detected"], second["first"]) == ("0", "")
    # twelve scenes are the first ten parts of the list and two of these again; eight fail, one in each of eight parts
    parts = list(csv.DictReader(io.StringIO(by_stratum_text(tuple(contests), cells))))  # type: ignore[arg-type] # the cells
    late = [row for row in parts if (row["background"], row["defect"]) == ("sumo", "late:strong")]
    assert len({(row["net"], row["stratum"]) for row in late}) == 10
    assert [row["scenes"] for row in late] == ["2", "2", *["1"] * 8]
    assert [row["failures"] for row in late] == [*["1"] * 8, "0", "0"]
    table = defects_table(tuple(contests), found, cells, folder)  # type: ignore[arg-type] # the cells
    lines = {line.key: line for line in table.lines}
    assert lines["late:strong"].cells["sumo"].best
    assert not lines["range:middle"].cells["replay"].best
    assert lines[SOUND].cells["replay"].found.value == 0.25
    assert lines["score"].cells["sumo"].found.value == 0.5
    text = markdown_text(table)
    assert "| lane_graph | SUMO (natural) (%) | late:strong less sound | +66.7 |" in text
    assert (
        "SUMO (natural) detects 1 of 2 in lane_graph; the first, late:strong, after 6 scenes, 18 episodes."
        in text
    )
    draw(tmp_path / "table.png", table)
    assert (tmp_path / "table.png").read_bytes().startswith(b"\x89PNG")


def test_defects_that_show_in_broken_rules_only_are_named(tmp_path: Path) -> None:
    """Seven of twelve scenes, two defects: 2 / 2⁷. What fails validly as well is named as detected only."""
    folder = Folder(tmp_path, REQUEST)
    breaks = {("sumo", "late:strong"): 8, ("sumo", "range:middle"): 7, ("replay", "late:strong"): 5}
    found, cells = gathered(folder, {("sumo", "late:strong"): 8}, breaks)
    contests = tuple(one for one in contests_of(found, cells) if one.target == "lane_graph")  # type: ignore[arg-type] # the cells
    rows = list(csv.DictReader(io.StringIO(detections_text(contests))))
    assert [(row["detected"], row["detected_by_rules"]) for row in rows] == [
        ("true", "true"),
        ("false", "true"),
        ("false", "false"),
        ("false", "false"),
    ]
    assert [row["broke_rule"] for row in rows] == ["8", "7", "5", "0"]
    assert float(rows[1]["rules_p_holm"]) == pytest.approx(1 / 2**7, rel=1e-5)  # the lower p is that of late
    notes = [
        note
        for note in defects_table(contests, found, cells, folder).notes  # type: ignore[arg-type] # the cells
        if "reveal" in note
    ]
    assert len(notes) == 1
    assert notes[0].endswith("Only rules broken without a collision reveal range:middle (7 of 12, sound 0).")


def test_the_order_of_scenes_is_that_of_the_list_in_which_nets_take_turns(tmp_path: Path) -> None:
    cells = plan_defects(Folder(tmp_path, REQUEST), Silent())
    order = scene_order(cells)
    first = sorted(
        {job.scene_key: cells.plan.options(job).net for _, job in cells.jobs()}.items(),
        key=lambda x: order[x[0]],
    )
    assert [net for _, net in first[:4]] == ["downtown", "downtown-left", "motorway", "downtown"]
    assert sorted(order.values()) == list(range(12))


def test_a_rate_that_every_defect_raises_ranks_all_of_them_above_the_sound_ones() -> None:
    """Of six pairs four are right and one is a tie: (4 + 1/2) / 6."""
    assert ranking_auc([0.0, 0.1], [0.2, 0.1, 0.05]) == pytest.approx(4.5 / 6.0)
    assert ranking_auc([0.0], [0.1, 0.5]) == 1.0
    assert ranking_auc([0.0], []) is None


def test_who_never_finished_has_no_rate_to_be_ranked_by(tmp_path: Path) -> None:
    found, cells = gathered(Folder(tmp_path, REQUEST), {("sumo", "late:strong"): 8})
    every = {(one.background, one.target): one.auc for one in contests_of(found, cells)}  # type: ignore[arg-type] # the cells
    assert every["sumo", "lane_graph"] == 0.75, "one of two above the sound one, the other level with it"
    for cell in found.finished:
        if (cell.row, cell.defect) == ("sumo", "range:middle"):
            found.finished[cell] = []
    finished = {(one.background, one.target): one.auc for one in contests_of(found, cells)}  # type: ignore[arg-type] # the cells
    assert finished["sumo", "lane_graph"] == 1.0


def test_what_is_planted_in_whom() -> None:
    everything = replace_request(defects=())
    assert len(planted_defects("lane_graph", everything)) >= 12
    assert {one.name.partition(":")[2] for one in planted_defects("lane_graph", everything)} == {"strong"}
    assert {one.kind.name for one in planted_defects("IDM", everything)} >= {"late", "headway", "weak-brakes"}
    assert all(one.kind.sumo is not None for one in planted_defects("IDM", everything))
    weak = replace_request(defects=("late", "range:9"), severity="weak")
    assert [one.name for one in planted_defects("lane_graph", weak)] == ["late:weak", "range:9"]
    with pytest.raises(ConfigError, match="defect 'tunnel' has no form for target 'IDM'"):
        planted_defects("IDM", replace_request(defects=("tunnel",)))
    with pytest.raises(UnknownNameError, match="did you mean 'tunnel'"):
        planted_defects("lane_graph", replace_request(defects=("tunel",)))
    with pytest.raises(ConfigError, match="given twice"):
        planted_defects("lane_graph", replace_request(defects=("late", "late:weak")))


def replace_request(**given: object) -> Request:
    return REQUEST.model_copy(update=given)


def test_outcomes_that_cannot_be_judged_are_no_failures() -> None:
    hit = {"target_collision": True, "valid_failure": None}
    assert EpisodeOutcome.of(hit, None) == EpisodeOutcome(False, 0.0)
    assert replace(EpisodeOutcome.of({**hit, "valid_failure": True}, 3.0), cpu_s=0.0).failed
