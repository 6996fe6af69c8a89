"""Check the requirements on every signal program of a written net, from its XML alone."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defusedxml.ElementTree import parse

LEAST_SIGNALS = {
    "nuscenes-mini/maps/expansion/singapore-onenorth.json": 7,
    "nuscenes-mini/maps/expansion/singapore-queenstown.json": 14,
    "nuscenes-mini/maps/expansion/singapore-hollandvillage.json": 19,
    "nuscenes-mini/maps/expansion/boston-seaport.json": 58,
    "argoverse2/log_map_archive_0a1e6f0a-1817-4a98-b02e-db8c9327d151.json": 1,
    "commonroad/USA_Lanker-1_3_T-1.xml.gz": 2,
    "commonroad/DEU_Moabit-4_1_T-1.xml.gz": 0,
    "commonroad/HRV_Pula-27_3_T-1.xml.gz": 0,
}
"""Real maps, and the smallest number of guessed signals, with and without pedestrian crossings."""


@dataclass(frozen=True)
class WrittenSignal:
    """A signal: its phases as (seconds, state), and for each link its foes and the links to which it yields."""

    name: str
    phases: list[tuple[float, str]]
    foes: dict[int, set[int]]
    yields_to: dict[int, set[int]]
    on_foot: set[int]


def written_signals(net: Path) -> list[WrittenSignal]:
    root: Any = parse(net).getroot()
    lane_of: dict[str, dict[int, str]] = defaultdict(dict)
    for row in root.iterfind("connection"):
        if row.get("tl") and row.get("via", row.get("to")):
            lane_of[row.get("tl")][int(row.get("linkIndex"))] = row.get("via") or f"{row.get('to')}_0"
    lanes = {j.get("id"): j.get("intLanes", "").split() for j in root.iterfind("junction")}
    rows = {
        lanes[j.get("id")][int(row.get("index"))]: (row, lanes[j.get("id")])
        for j in root.iterfind("junction")
        for row in j.iterfind("request")
    }
    signals = []
    for program in root.iterfind("tlLogic"):
        index_of = {lane: index for index, lane in lane_of[program.get("id")].items()}
        bits = {
            key: {index: _set_bits(*rows[lane], key, index_of) for lane, index in index_of.items()}
            for key in ("foes", "response")
        }
        phases = [(float(row.get("duration")), row.get("state")) for row in program.iterfind("phase")]
        on_foot = {index for lane, index in index_of.items() if "_c" in lane}
        signals.append(WrittenSignal(program.get("id"), phases, bits["foes"], bits["response"], on_foot))
    return signals


def _set_bits(row: Any, lanes: list[str], key: str, index_of: dict[str, int]) -> set[int]:
    marked = [lane for lane, bit in zip(lanes, reversed(row.get(key)), strict=True) if bit == "1"]
    return {index_of[lane] for lane in marked if lane in index_of}


def check_signals(net: Path) -> int:
    """Check all programs of *net* for safe phases; return the number of programs."""
    signals = written_signals(net)
    for signal in signals:
        check_greens(signal)
        check_changes(signal)
    return len(signals)


def check_greens(signal: WrittenSignal) -> None:
    """No two foes have ``G`` together; of two foes with green, the one with ``g`` yields; each link gets green."""
    for _, state in signal.phases:
        green = {index for index in signal.foes if state[index] in "Gg"}
        for index in green:
            for foe in (signal.foes[index] & green) - {index}:
                assert state[index] + state[foe] != "GG", f"{signal.name}: {index} and {foe} in {state}"
                if state[foe] == "G":
                    assert foe in signal.yields_to[index], f"{signal.name}: {index} does not yield to {foe}"
    assert all(any(state[index] in "Gg" for _, state in signal.phases) for index in signal.foes)


def check_changes(signal: WrittenSignal) -> None:
    """Vehicles get 3 to 6 s of yellow after each green, and only red after yellow."""
    follows = [*signal.phases[1:], signal.phases[0]]
    for index in set(signal.foes) - signal.on_foot:
        for (seconds, now), (_, later) in zip(signal.phases, follows, strict=True):
            assert now[index] not in "Gg" or later[index] in "Ggy", f"{signal.name}: {index}"
            if now[index] == "y":
                assert 3.0 <= seconds <= 6.0
                assert later[index] == "r"
