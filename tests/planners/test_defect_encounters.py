"""Each defect at its strongest severity fails in an encounter in SUMO in which the sound planner does not."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.planners.defects import DEFECTS
from tests.planners.encounters import (
    Encounter,
    Scripted,
    braking,
    crossing,
    failed,
    one_lane,
    over,
    sliding,
    two_lanes,
)

SHOWN_BY = {
    "late": "leader_brakes",
    "range": "leader_brakes",
    "flicker": "leader_brakes",
    "dropout": "leader_brakes",
    "tunnel": "give_way",
    "blind-crossing": "give_way",
    "blind-oncoming": "turn_across",
    "blind-standing": "standing_truck",
    "blind-heavy": "standing_truck",
    "blind-unprotected": "bicycle",
    "frozen": "give_way",
    "constant-velocity": "leader_brakes",
    "speed-bias": "standing_truck",
    "position-bias": "leader_brakes",
    "localisation": "leader_brakes",
    "weak-brakes": "leader_brakes",
    "slow-brakes": "leader_brakes",
    "headway": "leader_brakes",
    "signals": "red_light",
    "priority": "give_way",
    "cut-in": "cut_in",
    "stuck": "leader_brakes",
}
IN_SUMO = {"late": "leader_brakes", "weak-brakes": "leader_brakes", "stuck": "leader_brakes"}


@pytest.fixture(scope="module")
def encounters(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Encounter]:
    folder = tmp_path_factory.mktemp("nets")
    slow, fast, two = one_lane(folder, 13.89), one_lane(folder, 25.0), two_lanes(folder, 25.0)
    sign, light = crossing(folder, "priority"), crossing(folder, "traffic_light")
    right, left, along = ("WM_0", "ME_0"), ("WM_1", "ME_1"), ("WM", "ME")
    across, north = ("south_in", "north_out"), over(sign, "south_in", "north_out")
    beside = tuple(Scripted(left, s, 24.0) for s in (48.0, 28.0, 8.0))
    cutting = Scripted(right, 82.0, braking(22.0, 2.5, 4.0, 8.0), sliding(1.0, 2.5, 3.2))
    stream = tuple(Scripted(over(sign, "east_in", "west_out"), 280.0 - 28.0 * k, 13.0) for k in range(8))
    ahead = Scripted(right, 90.0, braking(22.0, 4.0, 6.0))
    truck = Scripted(right, 450.0, 0.0, kind=AgentClass.TRUCK)
    bicycle = Scripted(right, 200.0, 4.0, kind=AgentClass.BICYCLE)
    from_west = Scripted(over(sign, "west_in", "east_out"), 205.0, 13.0)
    at_green = Scripted(over(light, "west_in", "east_out"), 202.0, 13.0)
    return {
        "leader_brakes": Encounter(fast, Scripted(right, 50.0, 24.0), along, (ahead,), 18.0),
        "standing_truck": Encounter(fast, Scripted(right, 50.0, 24.0), along, (truck,), 25.0),
        "bicycle": Encounter(slow, Scripted(right, 50.0, 13.0), along, (bicycle,), 25.0),
        "cut_in": Encounter(two, Scripted(right, 50.0, 24.0), along, (cutting, *beside), 12.0),
        "give_way": Encounter(sign, Scripted(north, 200.0, 12.0), across, (from_west,), 14.0),
        "turn_across": Encounter(
            sign,
            Scripted(over(sign, "west_in", "north_out"), 200.0, 12.0),
            ("west_in", "north_out"),
            stream,
            20.0,
        ),
        "red_light": Encounter(light, Scripted(north, 200.0, 12.0), across, (at_green,), 14.0),
    }


@pytest.fixture(scope="module")
def sound(encounters: dict[str, Encounter]) -> Any:
    """Return a function for the row of an encounter without a defect, driven once."""
    return cache(lambda name, target="lane_graph": encounters[name].drive(target=target))


def test_every_defect_has_its_encounter() -> None:
    assert SHOWN_BY.keys() == DEFECTS.keys()


@pytest.mark.parametrize(("defect", "encounter"), SHOWN_BY.items())
def test_a_defect_shows(defect: str, encounter: str, encounters: dict[str, Encounter], sound: Any) -> None:
    assert not sound(encounter)["target_collision"]
    assert failed(encounters[encounter].drive([f"{defect}:strong"]))


@pytest.mark.parametrize(("defect", "encounter"), IN_SUMO.items())
def test_a_defect_shows_in_a_driver_of_sumo(
    defect: str, encounter: str, encounters: dict[str, Encounter], sound: Any
) -> None:
    assert not sound(encounter, "Krauss")["target_collision"]
    assert failed(encounters[encounter].drive([f"{defect}:strong"], "Krauss"))


def test_the_same_defect_gives_the_same_episode(encounters: dict[str, Encounter]) -> None:
    first, again = (encounters["leader_brakes"].drive(["flicker:middle", "late:weak"]) for _ in range(2))
    assert first == again
