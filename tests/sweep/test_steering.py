"""Which episodes a diverse sweep chooses next: single cases by hand, and properties."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.metrics.archive import APPROACHES, MANOEUVRES, ArchiveCell, archive, cell_of
from advdiff_sumo.sweep.steering import Candidate, Steering

KINDS = ("hard-stop", "cut-in", "crossing")


def candidate(kind: str, scene: int) -> Candidate:
    return Candidate(f"{kind}-{scene}", "lane_graph {}", "downtown", kind, f"scene-{scene}")


def row(
    kind: str, approach: str | None = "ahead", manoeuvre: str = "straight", **values: Any
) -> dict[str, Any]:
    """Return the columns of an episode that the archive reads; a valid failure unless *values* say otherwise."""
    plain = {
        "episode": 0,
        "attack": kind,
        "approach": approach,
        "target_manoeuvre": manoeuvre,
        "end": "collision",
        "in_position": True,
        "target_collision": True,
        "valid_failure": True,
        "at_fault": "target",
        "closing_speed_mps": 5.0,
        "critical": False,
        "critical_brake_mps2": None,
        "min_ttc_s": None,
        "min_clearance_m": 0.0,
    }
    return plain | values


def test_the_cell_of_an_episode() -> None:
    assert cell_of(row("cut-in", "beside_left")) == ArchiveCell("cut-in", "beside_left", "straight")
    assert cell_of(row("cut-in", in_position=None)) is not None
    for values in ({"in_position": False}, {"end": "failed"}):
        assert cell_of(row("cut-in", **values)) is None
    assert cell_of(row("cut-in", None)) is None
    met = cell_of(row("any", "ahead", attacker_manoeuvre="hard-stop"))
    assert met == ArchiveCell("hard-stop", "ahead", "straight")


def test_a_cell_keeps_the_worst_episode() -> None:
    mild, hard = (row("cut-in", episode=k, closing_speed_mps=speed) for k, speed in ((1, 2.0), (2, 9.0)))
    near = row("cut-in", episode=3, target_collision=False, valid_failure=False, end="horizon")
    other = row("crossing", "from_left", valid_failure=False)
    cells = archive([mild, near, hard, other])
    assert list(cells) == [("crossing", "from_left", "straight"), ("cut-in", "ahead", "straight")]
    elite = cells[ArchiveCell("cut-in", "ahead", "straight")]
    assert (elite.episodes, elite.valid, elite.worst["episode"]) == (3, 2, 2)


def test_without_results_every_kind_and_scene_is_tried_in_turn() -> None:
    pool = [candidate(kind, scene) for kind in KINDS for scene in range(4)]
    keys = Steering.after([]).pick(pool, 3)
    assert keys == ["hard-stop-0", "cut-in-1", "crossing-2"]


def test_a_kind_that_has_filled_its_cell_comes_later() -> None:
    """More of four equal valid failures fill no cell; a kind without a row in eight episodes is no better."""
    alike = [(candidate("hard-stop", scene), row("hard-stop")) for scene in range(4)]
    fresh = [candidate(kind, scene) for scene in range(10, 12) for kind in KINDS]
    first = Steering.after(alike).pick(fresh, 2)
    assert [key.rpartition("-")[0] for key in first] == ["cut-in", "crossing"]
    never = [(candidate("crossing", scene), None) for scene in range(8)]
    first = Steering.after([*alike, *never]).pick(fresh, 2)
    assert "crossing" not in {key.rpartition("-")[0] for key in first}


def test_a_scene_without_an_attack_comes_later() -> None:
    jam = [(candidate(kind, 0), row(kind, in_position=False)) for kind in KINDS[:2]]
    assert Steering.after(jam).pick([candidate("crossing", scene) for scene in (0, 1)], 1) == ["crossing-1"]


def test_a_near_miss_is_promising() -> None:
    near = row("cut-in", target_collision=False, valid_failure=False, end="horizon", critical=True)
    calm = near | {"attack": "crossing", "critical": False}
    results = [(candidate("cut-in", 0), near), (candidate("crossing", 1), calm)]
    pool = [candidate("crossing", 2), candidate("cut-in", 3)]
    assert Steering.after(results).pick(pool, 1) == ["cut-in-3"]


def test_a_scene_in_which_the_target_turns_fills_what_is_empty() -> None:
    """The target went straight in all hard stops so far: a scene in which it turned comes first."""
    results = [(candidate("hard-stop", scene), row("hard-stop")) for scene in range(3)]
    results += [
        (candidate("cut-in", 5), row("cut-in", valid_failure=False)),
        (candidate("cut-in", 6), row("cut-in", manoeuvre="turn_left", valid_failure=False)),
    ]
    pool = [candidate("hard-stop", 5), candidate("hard-stop", 6)]
    assert Steering.after(results).pick(pool, 1) == ["hard-stop-6"]


@given(data=st.data())
def test_episodes_are_picked_once_and_never_invented(data: st.DataObject) -> None:
    pool = [candidate(kind, scene) for kind in KINDS for scene in range(5)]
    done = data.draw(st.lists(st.sampled_from(pool), unique=True))
    results = [
        (
            option,
            row(
                option.kind,
                data.draw(st.sampled_from(APPROACHES)),
                data.draw(st.sampled_from(MANOEUVRES)),
                valid_failure=data.draw(st.booleans()),
            ),
        )
        for option in done
    ]
    remaining = [option for option in pool if option not in done]
    count = data.draw(st.integers(0, 20))
    keys = Steering.after(results).pick(remaining, count)
    assert len(keys) == len(set(keys)) == min(count, len(remaining))
    assert set(keys) <= {option.key for option in remaining}
    assert keys == Steering.after(results).pick(remaining, count)
