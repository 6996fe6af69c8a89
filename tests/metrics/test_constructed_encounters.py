"""Verdicts of the encounters of ``constructed_encounters``, as they stand, mirrored, and with the parties exchanged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.collision import collisions
from advdiff_sumo.metrics.verdict import Verdict, judge
from tests.metrics.constructed_encounters import ENCOUNTERS
from tests.metrics.encounter_casts import Constructed, Expected
from tests.metrics.encounters import Car, build, crossing, record_of, signals_of

_RING = {"E": (18, 0), "N": (0, 18), "W": (-18, 0), "S": (0, -18), "I": (-150, 0), "O": (0, -150)}
_SIDE_EDGES = {"SC": "NC", "NC": "SC", "CN": "CS", "CS": "CN"}
CASES = [
    pytest.param(
        case, lefthand, exchanged, id=f"{case.name}{', left-hand' * lefthand}{', exchanged' * exchanged}"
    )
    for case in ENCOUNTERS
    for lefthand in (False, True)
    for exchanged in (False, True)
    if not exchanged or case.exchanged is not None
]


def roundabout(folder, lefthand: bool) -> RoadMap:
    """Make a roundabout with one entry, IW, and one exit, SO; entering vehicles give way."""
    side = -1 if lefthand else 1
    nodes = "".join(f'<node id="{n}" x="{x}" y="{side * y}"/>' for n, (x, y) in _RING.items())
    arcs = (
        ("E", "N", 12.7, 12.7),
        ("N", "W", -12.7, 12.7),
        ("W", "S", -12.7, -12.7),
        ("S", "E", 12.7, -12.7),
    )
    edges = "".join(
        f'<edge id="{a}{b}" from="{a}" to="{b}" priority="9" numLanes="1"'
        f' shape="{_RING[a][0]},{side * _RING[a][1]} {x},{side * y} {_RING[b][0]},{side * _RING[b][1]}"/>'
        for a, b, x, y in arcs
    )
    edges += '<edge id="IW" from="I" to="W" priority="1"/><edge id="SO" from="S" to="O" priority="1"/>'
    ring = '<roundabout nodes="E N W S" edges="EN NW WS SE"/>'
    return build(folder, f"<nodes>{nodes}</nodes>", f"<edges>{edges}{ring}</edges>", "ring", lefthand)


@pytest.fixture(scope="module")
def road_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, bool], RoadMap]:
    """Return a maker of maps, each made once."""
    made: dict[tuple[str, bool], RoadMap] = {}

    def road(net: str, lefthand: bool) -> RoadMap:
        if (net, lefthand) not in made:
            folder = tmp_path_factory.mktemp(net)
            made[net, lefthand] = (
                roundabout(folder, lefthand) if net == "roundabout" else crossing(folder, net, lefthand)
            )
        return made[net, lefthand]

    return road


def mirrored(car: Car) -> Car:
    """Return *car* with left and right exchanged."""
    return replace(car, xy_m=car.xy_m * (1.0, -1.0), yaw_rad=-car.yaw_rad)


def record_for(case: Constructed, road: RoadMap, lefthand: bool, exchanged: bool) -> EpisodeRecord:
    """Return the record of *case*, the target first."""
    cars, route, lights = case.cast(road), case.routes[exchanged], dict(case.lights)
    if lefthand and case.net != "roundabout":
        route = tuple(_SIDE_EDGES.get(edge, edge) for edge in route)
        lights = {tuple(_SIDE_EDGES.get(x[:2], x[:2]) + x[2:] for x in k): v for k, v in lights.items()}
    if lefthand and not case.made_for:
        cars = tuple(map(mirrored, cars))
    if exchanged:
        cars = (cars[1], cars[0], *cars[2:])
    signals = signals_of(road, lights, len(cars[0].speed_mps)) if lights else ()
    return record_of(*cars, route=route, signals=signals)


def verdict_of(record: EpisodeRecord, road: RoadMap) -> Verdict:
    """Return the verdict of the contact of the first two of *record*."""
    hits = [x for x in collisions(record) if set(x.rows) == {0, 1} and not x.initial]
    assert len(hits) == 1, "the encounter was meant to hold one contact of the two"
    return judge(record, road, hits[0])


@pytest.mark.parametrize(("case", "lefthand", "exchanged"), CASES)
def test_verdict(road_of, case: Constructed, lefthand: bool, exchanged: bool) -> None:
    road = road_of(case.net, lefthand)
    expected: Expected | None = case.exchanged if exchanged else case.given
    assert expected is not None
    verdict = verdict_of(record_for(case, road, lefthand, exchanged), road)
    own, other = ([str(x.kind) for x in side] for side in (verdict.target_breaches, verdict.other_breaches))
    assert (own, other) == (list(expected.own), list(expected.other)), verdict.sentence
    assert str(verdict.fault.at_fault) == expected.fault, verdict.fault.reason
    assert verdict.lawful is (not expected.other)
    assert verdict.valid_failure is expected.valid, verdict.sentence
    if expected.preventable is not None:
        assert verdict.preventable is expected.preventable, verdict.sentence
    if expected.spare_m is not None:
        assert verdict.spare_m == pytest.approx(expected.spare_m[0], abs=expected.spare_m[1])
    if expected.impact_mps is not None:
        assert verdict.impact_left_mps == pytest.approx(expected.impact_mps[0], abs=expected.impact_mps[1])
    assert expected.says in verdict.sentence
    if verdict.preventable:
        assert verdict.unavoidable is False
        assert verdict.impact_left_mps is None
