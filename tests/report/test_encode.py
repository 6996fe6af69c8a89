"""Blocks: what is packed is what the page's script reads, which is written again here."""

from __future__ import annotations

import base64
import json
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.report.blocks import deviating_tracks, episode_block, streets_block
from advdiff_sumo.report.encode import (
    NOTHING,
    block,
    path_parts,
    second_differences,
    wrapped_differences,
)
from advdiff_sumo.report.layer import MapLayer
from advdiff_sumo.report.nets import RoadMap
from advdiff_sumo.report.plans import Planned, packed_plans
from advdiff_sumo.report.reference_episodes import thinned_tracks
from advdiff_sumo.report.series import series_of


def _unpacked(text: str) -> tuple[dict[str, Any], list[int]]:
    raw = zlib.decompress(base64.b64decode(text))
    length = int.from_bytes(raw[:4], "little")
    codes = raw[4 + length :]
    half = len(codes) // 2
    numbers = []
    for low, high in zip(codes[:half], codes[half:], strict=True):
        code = low | high << 8
        numbers.append(-(code + 1) // 2 if code & 1 else code // 2)
    return json.loads(raw[4 : 4 + length]), numbers


@given(st.lists(st.integers(-32768, 32767)))
def test_numbers_come_back(numbers: list[int]) -> None:
    header, found = _unpacked(block({"a": "ü"}, [np.array(numbers, dtype=np.int64)]))
    assert header == {"a": "ü"}
    assert found == numbers


def test_too_large_a_number_is_refused() -> None:
    with pytest.raises(ValueError, match="16 bits"):
        block({}, [np.array([32768])])


@given(st.lists(st.integers(-5000, 5000), min_size=1))
def test_second_differences_are_undone_by_two_sums(values: list[int]) -> None:
    found = second_differences(np.array(values))
    steps = np.cumsum(found)
    assert [values[0], *(values[0] + np.cumsum(steps)).tolist()] == values


def _sums(differences: IntArray) -> list[int]:
    return (((np.cumsum(differences) + 32768) % 65536) - 32768).tolist()


def test_series_by_hand() -> None:
    values = np.array([1.234, np.nan, -400.0, 0.0, 400.0])
    assert _sums(wrapped_differences(values)) == [123, NOTHING, -32767, 0, 32767]


@given(st.lists(st.floats(-300.0, 300.0) | st.just(float("nan"))))
def test_series_to_half_a_hundredth(values: list[float]) -> None:
    wanted = np.array(values)
    found = np.array(_sums(wrapped_differences(wanted)), dtype=np.float64)
    found = np.where(found == NOTHING, np.nan, found / 100.0)
    np.testing.assert_allclose(found, wanted, atol=0.005001)


def test_gaps_and_jumps_part_a_path() -> None:
    nan = np.nan
    xy = np.array(
        [[nan, nan], [0, 0], [1, 0], [2, 0], [nan, nan], [3, 0], [500, 0], [501, 0]], dtype=np.float64
    )
    heads = [head for head, _ in path_parts(xy, np.zeros(8), np.zeros(2))]
    assert heads == [[1, 3, 0, 0, 0], [5, 1, 300, 0, 0], [6, 2, 50000, 0, 0]]


def _tracks(y_m: FloatArray) -> Tracks:
    """Return agents "a", "b", … that go east at 10 m/s, at (A, T) *y_m*."""
    agents, steps = y_m.shape
    x = np.broadcast_to(np.arange(steps, dtype=np.float64), y_m.shape)
    return Tracks(
        ids=tuple("abcdefgh"[:agents]) if agents <= 8 else tuple(f"v{k}" for k in range(agents)),
        classes=np.zeros(agents, dtype=np.int64),
        size_m=np.tile((5.0, 2.0), (agents, 1)),
        xy_m=np.stack((x, y_m), axis=-1),
        yaw_rad=np.zeros((agents, steps)),
        speed_mps=np.full((agents, steps), 10.0),
        valid=np.ones((agents, steps), dtype=np.bool_),
        t0_s=0.0,
        dt_s=0.1,
    )


def test_only_those_who_depart_have_a_ghost_and_the_target() -> None:
    driven = _tracks(np.repeat([[0.0], [4.0], [8.0]], 21, axis=1))
    other = driven.xy_m.copy()
    other[1, 10:, 1] += 0.6
    other[2, 10:, 1] += 0.4
    natural = _tracks(other[..., 1])
    assert deviating_tracks(EpisodeStates(driven, 0), natural).ids == ("a", "b")
    half = thinned_tracks(natural)  # 0, 0.5, … 2.0 s
    between = deviating_tracks(EpisodeStates(driven.window(0, 8), 0), half)
    assert between.times_s == pytest.approx([0.0, 0.5, 1.0])  # it ends at 0.7 s
    assert between.ids == ("a",)  # "b" departs later
    late = deviating_tracks(EpisodeStates(driven, 0), natural.shifted(-1.5))
    assert late.t0_s == pytest.approx(0.0)
    assert late.steps == 6


def test_natural_after_the_episode_is_nothing() -> None:
    driven = _tracks(np.zeros((1, 5)))
    assert deviating_tracks(EpisodeStates(driven, 0), driven.shifted(60.0)).agents == 0


def test_two_hundred_episodes_of_a_hundred_vehicles_fit() -> None:
    steps, agents = 201, 100
    rng = np.random.default_rng(5)
    turn = np.cumsum(0.02 * np.cumsum(rng.normal(0.0, 0.05, (agents, steps)), axis=1), axis=1)
    speed = 8.0 + np.cumsum(rng.normal(0.0, 0.05, (agents, steps)), axis=1)
    plain = _tracks(np.zeros((agents, steps)))
    ahead = np.stack((np.cos(turn), np.sin(turn)), axis=-1) * speed[..., None] * 0.1
    xy = rng.uniform(0.0, 200.0, (agents, 1, 2)) + np.cumsum(ahead, axis=1)
    tracks = Tracks(plain.ids, plain.classes, plain.size_m, xy, turn, speed, plain.valid, 0.0, 0.1)
    states = EpisodeStates(tracks, 0)
    text = episode_block(states, "v1", series_of(states, "v1"), None)
    assert 200 * len(text) < 24_000_000


def _plans_again(
    header: dict[str, Any], numbers: list[int]
) -> dict[int, list[tuple[float, int, FloatArray]]]:
    """Return by row (made, first step, positions relative to the origin) of a block's plans."""
    found: dict[int, list[tuple[float, int, FloatArray]]] = {}
    left = iter(numbers)
    for series in header["series"]:
        made, place = 0, np.array([series["x"], series["y"]])
        for _ in range(series["n"]):
            made, first, count = made + next(left), next(left), next(left)
            place = place + np.array([next(left), next(left)])
            steps = [np.cumsum(np.cumsum([next(left) for _ in range(count - 1)])) for _ in range(2)]
            xy = np.stack([np.concatenate(([p], p + s)) for p, s in zip(place, steps, strict=True)], axis=-1)
            found.setdefault(series["r"], []).append((made * header["dt"], first, xy / 100.0))
    assert next(left, None) is None
    return found


def test_plans_come_back() -> None:
    """The second plan of "a" starts a step late; its third is 400 m off, more than 16 bits hold."""
    points = np.array([[400.0, 300.0], [402.5, 300.4], [405.5, 301.0]])
    half = np.array([0.5, 1.0, 1.5])
    plans = [
        Planned("a", 0.0, half, points),
        Planned("a", 1.0, 1.5 + half, points + 3.0),
        Planned("a", 2.0, 2.0 + half, points + 400.0),
        Planned("b", 1.0, 1.0 + half[:1], points[:1]),
        Planned("stranger", 1.0, 1.0 + half, points),
    ]
    origin = np.array([10.0, 20.0])
    header, numbers = packed_plans(plans, {"b": 0, "a": 4}, origin)
    assert header is not None
    assert (header["dt"], header["every"]) == (0.5, 1.0)
    assert [series["n"] for series in header["series"]] == [2, 1, 1]
    found = _plans_again(header, np.concatenate(numbers).tolist())
    assert [(made, first) for made, first, _ in found[4]] == [(0.0, 1), (1.0, 2), (2.0, 1)]
    for plan, (_, _, xy) in zip(plans, [*found[4], *found[0]], strict=False):
        np.testing.assert_allclose(xy, plan.xy_m - origin, atol=1e-9)


def test_no_plans_are_no_header() -> None:
    assert packed_plans([], {"a": 0}, np.zeros(2)) == (None, [])


def test_streets_cover_the_path_and_nothing_far(networks: Any) -> None:
    layer = MapLayer(RoadMap.read(networks / "downtown.net.xml"))
    path = np.array([[300.0, 300.0], [np.nan, np.nan], [320.0, 300.0]])
    header, numbers = _unpacked(streets_block(layer, [path]))
    corners = [cell["at"] for cell in header["cells"]]
    assert [250.0, 250.0] in corners
    assert all(0.0 <= value <= 500.0 for corner in corners for value in corner)
    counts = [count for cell in header["cells"] for group in cell["lines"] for count in group]
    assert 2 * sum(counts) == len(numbers)
