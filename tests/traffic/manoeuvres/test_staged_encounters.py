"""On an empty road staging creates the encounter that shows a defect; sound and careful drivers pass it."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from tests.planners.encounters import (
    Encounter,
    Scripted,
    bending,
    crossing,
    failed,
    over,
    three_lanes,
    two_lanes,
)

SEED, MOTORCYCLE_FIRST = 3, 6
"""Seeds of episodes; in the second a motorcycle is inserted first."""
SHOWN_BY = [
    ("blind-crossing", "give_way", "crossing", SEED),
    ("priority", "give_way", "crossing", SEED),
    ("tunnel", "give_way", "crossing", SEED),
    ("frozen", "give_way", "crossing", SEED),
    ("blind-oncoming", "turn_across", "crossing", SEED),
    ("signals", "red_light", "crossing", SEED),
    ("cut-in", "beside", "cut-in", SEED),
    ("late", "beside", "hard-stop", SEED),
    ("blind-heavy", "beside", "hard-stop", SEED),
    ("blind-standing", "town", "cut-out", SEED),
    ("headway", "fast", "cut-out", SEED),
    ("speed-bias", "fast", "cut-out", SEED),
    ("blind-standing", "beside", "queue", SEED),
    ("weak-brakes", "fast", "queue", SEED),
    ("weak-brakes", "street", "slow-merge", SEED),
    ("cut-in", "street", "slow-merge", SEED),
    ("range", "kerb", "pull-out", SEED),
    ("cut-in", "kerb", "pull-out", SEED),
    ("blind-unprotected", "beside", "hard-stop", MOTORCYCLE_FIRST),
    ("blind-oncoming", "turn_across", "oncoming", SEED),
    ("priority", "turn_across", "oncoming", SEED),
    ("blind-oncoming", "bend", "oncoming", SEED),
    ("priority", "bend", "oncoming", SEED),
    ("late", "fast", "double", SEED),
    ("headway", "between", "double", SEED),
]
NARROW = ("NearestThree", "NearestAhead")


@pytest.fixture(scope="module")
def encounters(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Encounter]:
    folder = tmp_path_factory.mktemp("nets")
    sign, two = crossing(folder, "priority"), two_lanes(folder, 20.0)
    light = crossing(folder, "traffic_light")
    north = ("south_in", "north_out")
    from_south = Scripted(over(sign, *north), 225.0, 11.0)
    left = ("west_in", "north_out")
    bend, straight = bending(folder), ("west_in", "east_out")
    three = three_lanes(folder, 14.0)
    beside = Encounter(two, Scripted(("WM_0", "ME_0"), 50.0, 18.0), ("WM", "ME"), (), 20.0)
    town = Encounter(two_lanes(folder, 9.0), Scripted(("WM_0", "ME_0"), 50.0, 8.8), ("WM", "ME"), (), 14.0)
    fast = Encounter(two_lanes(folder, 33.0), Scripted(("WM_0", "ME_0"), 50.0, 31.0), ("WM", "ME"), (), 20.0)
    avenue = two_lanes(folder, 14.0)
    street = Encounter(avenue, Scripted(("WM_0", "ME_0"), 50.0, 13.0), ("WM", "ME"), (), 14.0)
    kerb = Encounter(avenue, Scripted(("WM_1", "ME_1"), 50.0, 13.0), ("WM", "ME"), (), 14.0)
    return {
        "street": street,
        "kerb": kerb,
        "fast": fast,
        "town": town,
        "give_way": Encounter(sign, from_south, north, (), 12.0),
        "wait": Encounter(sign, from_south, north, (), 16.0),
        "turn_across": Encounter(sign, Scripted(over(sign, *left), 225.0, 11.0), left, (), 12.0),
        "red_light": Encounter(light, Scripted(over(light, *north), 190.0, 12.0), north, (), 14.0),
        "beside": beside,
        "bend": Encounter(bend, Scripted(over(bend, *straight), 225.0, 11.0), straight, (), 12.0),
        "between": Encounter(three, Scripted(("WM_1", "ME_1"), 50.0, 12.5), ("WM", "ME"), (), 20.0),
    }


@pytest.fixture(scope="module")
def sound(encounters: dict[str, Encounter]) -> Any:
    """Return the result of an encounter without a defect, driven once."""
    return cache(lambda name, attack, seed, target: drive(encounters[name], attack, [], seed, target))


def drive(
    encounter: Encounter, attack: str, defects: list[str], seed: int, target: str = "lane_graph"
) -> dict[str, Any]:
    return encounter.drive(defects, target, "scripted", {"attack": attack}, seed)


@pytest.mark.slow
@pytest.mark.parametrize(("defect", "encounter", "attack", "seed"), SHOWN_BY)
def test_an_encounter_is_staged_that_shows_the_defect(
    defect: str, encounter: str, attack: str, seed: int, encounters: dict[str, Encounter], sound: Any
) -> None:
    for target in ("lane_graph", "careful"):
        row = sound(encounter, attack, seed, target)
        assert row["in_position"]
        assert not row["target_collision"]
    row = drive(encounters[encounter], attack, [f"{defect}:strong"], seed)
    assert failed(row)
    assert row["lawful"]


@pytest.mark.slow
@pytest.mark.parametrize("planner", NARROW)
@pytest.mark.parametrize("encounter", ["between", "beside"])
def test_a_planner_that_tracks_only_the_nearest_runs_into_a_masked_leader(
    planner: str, encounter: str, encounters: dict[str, Encounter]
) -> None:
    row = drive(encounters[encounter], "double", [], SEED, f"tests.planners.narrow_planners:{planner}")
    assert failed(row)
    assert row["lawful"]
    alone = drive(encounters[encounter], "hard-stop", [], SEED, f"tests.planners.narrow_planners:{planner}")
    assert alone["in_position"]
    assert not alone["target_collision"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("encounter", "attack", "planner", "breach", "other_attack"),
    [
        ("beside", "close-pass", "WithoutMirrors", "sideways", "hard-stop"),
        ("beside", "blind-spot", "WithoutMirrors", "sideways", "hard-stop"),
        ("street", "blind-spot", "WithoutRearMirror", "sideways", "close-pass"),
        ("wait", "short-gaps", "SetsOffWithoutLooking", "right_of_way", "crossing"),
    ],
)
def test_a_planner_that_does_not_look_fails_in_the_attack_that_is_for_it(
    encounter: str,
    attack: str,
    planner: str,
    breach: str,
    other_attack: str,
    encounters: dict[str, Encounter],
    sound: Any,
) -> None:
    """It overtakes without a look to the side, or sets off from a line without one to those who cross."""
    for target in ("lane_graph", "careful"):
        row = sound(encounter, attack, SEED, target)
        assert row["in_position"]
        assert not row["target_collision"]
    blind = f"tests.planners.narrow_planners:{planner}"
    row = drive(encounters[encounter], attack, [], SEED, blind)
    assert failed(row)
    assert row["lawful"]
    assert row["target_breaches"] == breach
    assert not drive(encounters[encounter], other_attack, [], SEED, blind)["target_collision"]
