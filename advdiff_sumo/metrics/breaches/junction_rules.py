"""Rules where ways cross or join: red lights, and giving way."""

from __future__ import annotations

import numpy as np
import shapely

from advdiff_sumo.core.arrays import BoolArray, FloatArray
from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.signal_letters import PROTECTED_GREEN, RED
from advdiff_sumo.metrics.breaches.breach import Breach, BreachKind
from advdiff_sumo.metrics.encounter import (
    BREACH_WINDOW_S,
    LEAST_SPEED_MPS,
    STOOD_S,
    Encounter,
    JunctionEntry,
    Party,
)
from advdiff_sumo.metrics.safe_gap import safe_gap_m
from advdiff_sumo.metrics.traffic_view import TrafficView

#: What who runs a red light did.
ON_RED = "entered the junction on red"
#: At a junction without rule, whoever came this much later gives way.
ARRIVAL_MARGIN_S = 1.0
#: A crossing is a line in the net; whoever walks within this distance of it is on it.
_CROSSING_HALF_WIDTH_M = 2.5


def red_light(view: TrafficView, met: Encounter, which: int) -> Breach | None:
    """Return the breach of entering the junction of *met* on red, unless the other came by the same approach."""
    party = met.parties[which]
    walker = met.parties[1 - which].is_pedestrian
    if not (met.crossing or walker) or not ran_red(view, party) or not _lately(view, met, party):
        return None
    return _breach(view, met, BreachKind.RED_LIGHT, party, ON_RED)


def right_of_way(view: TrafficView, met: Encounter, which: int) -> Breach | None:
    """Return the breach of not giving way to the other at the junction, or at the crossing, of *met*.

    Whoever has stood there for a second could be seen and is no longer the cause, and neither is one that joined
    the other's lane with a safe gap.
    """
    party, other = met.parties[which], met.parties[1 - which]
    if party.stood or party.is_pedestrian or (other.stood and not other.is_pedestrian):
        return None
    if way_is_unknown(view, met):
        return None
    if other.is_pedestrian:
        return _crossing_breach(view, met, party, other)
    if not met.crossing or not _lately(view, met, party):
        return None
    if (
        ran_red(view, party)
        or ran_red(view, other)
        or joined_safely(met, which)
        or not owes_way(view, met, which)
    ):
        return None
    return _breach(
        view, met, BreachKind.RIGHT_OF_WAY, party, f"did not give way to '{other.name}' at the junction"
    )


def disregarded(view: TrafficView, met: Encounter, walker: int) -> Breach | None:
    """Return the breach by which the other drove into the one who walks: on red, or on a crossing; else None.

    Of a crossing only where the other still had room to stop when the one who walks came over the kerb, or walked on.

    Args:
        view: who is where.
        met: the collision with its circumstances.
        walker: 0 or 1, who may be walking.
    """
    if not met.parties[walker].is_pedestrian:
        return None
    on_red = red_light(view, met, 1 - walker)
    if on_red is not None or not _could_stop(view, met, walker):
        return on_red
    return right_of_way(view, met, 1 - walker)


def _could_stop(view: TrafficView, met: Encounter, walker: int) -> bool:
    """Return whether the other had the safe gap to the place of the contact as *walker* came onto the crossing."""
    tracks, hit = view.tracks, met.collision
    other = met.parties[1 - walker].row
    begun = _set_foot(view, met.parties[walker], hit.step, tracks.valid[other])
    way = np.vstack((tracks.xy_m[other, begun : hit.step + 1], hit.xy_m[hit.rows.index(other)]))
    left_m = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    return left_m >= safe_gap_m(abs(float(tracks.speed_mps[other, begun])), 0.0)


def _set_foot(view: TrafficView, walker: Party, last: int, seen: BoolArray) -> int:
    """Return the instant since which *walker* has walked on a crossing, shorter pauses than ``STOOD_S`` included.

    Args:
        view: who is where.
        walker: who walks.
        last: instant before the contact.
        seen: (T,) instants at which the other is there.
    """
    tracks, row, begun, roadways = view.tracks, walker.row, last, _roadways(view)
    for step in range(last - 1, max(-1, last - view.steps(BREACH_WINDOW_S) - 1), -1):
        if not (seen[step] and tracks.valid[row, step]) or begun - step > view.steps(STOOD_S):
            break
        if not any(line.intersects(shapely.Point(tracks.xy_m[row, step])) for line in roadways):
            break
        if abs(float(tracks.speed_mps[row, step])) > LEAST_SPEED_MPS:
            begun = step
    return begun


def _roadways(view: TrafficView) -> list[shapely.Polygon]:
    """Return where crossings are, from kerb to kerb."""
    lines = (shapely.LineString(xy) for xy in _crossings(view))
    return [line.buffer(_CROSSING_HALF_WIDTH_M, cap_style="flat") for line in lines]


def _crossings(view: TrafficView) -> list[FloatArray]:
    """Return the middle lines (N, 2) of pedestrian crossings."""
    shapes = view.road.pedestrian_shapes  # of crossings ":JUNCTION_c0" and walking areas ":JUNCTION_w0"
    return [xy for name, xy in shapes.items() if name.rpartition("_")[2].startswith("c") and len(xy) > 1]


def ran_red(view: TrafficView, party: Party | JunctionEntry) -> bool:
    """Return whether *party* entered the junction while its signal was red, from its front's passing the line on."""
    states = signals_at_entry(view, party)
    return bool(states) and all(state in RED for state in states)


def signals_at_entry(view: TrafficView, party: Party | JunctionEntry) -> list[str]:
    """Return the letters of the signal of *party* from the instant before its front passed the line to its entry.

    [] if unknown. Who waits with its front over the line enters by what it sees as it goes on.
    """
    link, first, last = party.link, party.line_step, party.entered_step
    if link is None or link.tls_id is None or link.tls_index is None or link.tls_index < 0:
        return []
    if first is None or last is None:
        return []
    states = [s.get(link.tls_id, "") for s in view.signals[max(0, first - 1) : last + 1]]
    return [s[link.tls_index] for s in states] if all(len(s) > link.tls_index for s in states) else []


def way_is_unknown(view: TrafficView, met: Encounter) -> bool:
    """Return whether a light said who goes at the junction, or the crossing, of *met*, and no signals of it are held.

    Rows of the net then tell nothing: they are for vehicles that have a green at once.
    """
    lights = {party.link.tls_id for party in met.parties if party.link is not None} - {None}
    if not any(all(light not in states for states in view.signals) for light in lights):
        return False
    return met.crossing or any(
        x.is_pedestrian and on_crossing(view, x, met.collision.step) for x in met.parties
    )


def owes_way(view: TrafficView, met: Encounter, which: int) -> bool:
    """Return whether the party must give way: by the net, or, where neither or both must, as the later to come."""
    yields = must_yield(view, *met.parties), must_yield(view, *met.parties[::-1])
    if yields[0] != yields[1]:
        return yields[which]
    later_s = later_by_s(view, met)
    if later_s is None:
        return False
    return (later_s if which == 0 else -later_s) > ARRIVAL_MARGIN_S


def later_by_s(view: TrafficView, met: Encounter) -> float | None:
    """Return by how much the target's front came later than the other's; None where they were not seen."""
    target, other = met.target.line_step, met.other.line_step
    return None if target is None or other is None else (target - other) * view.tracks.dt_s


def must_yield(view: TrafficView, party: Party, to: Party) -> bool:
    """Return whether the net has *party* give way to *to*; who enters on a protected green never does."""
    if party.link is None or to.link is None or PROTECTED_GREEN in signals_at_entry(view, party):
        return False
    return view.road.must_yield(party.link, to.link)


def _lately(view: TrafficView, met: Encounter, party: Party) -> bool:
    entered = party.entered_step
    return entered is None or met.collision.step - entered <= view.steps(BREACH_WINDOW_S)


def joined_safely(met: Encounter, which: int) -> bool:
    """Return whether the other ran into the rear of the party, which had joined its way with a safe gap."""
    entry = met.entry
    if entry is None or entry.row != met.parties[which].row or not entry.ahead:
        return False
    return (entry.safe or entry.recovered) and met.is_run_into(which)


def _crossing_breach(view: TrafficView, met: Encounter, party: Party, walker: Party) -> Breach | None:
    """Return the breach of running into somebody on a crossing, unless the driver had a protected green."""
    if PROTECTED_GREEN in signals_at_entry(view, party) or not on_crossing(view, walker, met.collision.step):
        return None
    return _breach(
        view, met, BreachKind.RIGHT_OF_WAY, party, f"did not give way to '{walker.name}' on the crossing"
    )


def on_crossing(view: TrafficView, walker: Party, step: int) -> bool:
    """Return whether *walker* is on a pedestrian crossing at instant *step*."""
    tracks, row = view.tracks, walker.row
    box = shapely.Polygon(corners(tracks.xy_m[row, step], tracks.yaw_rad[row, step], tracks.size_m[row]))
    return any(shapely.LineString(xy).distance(box) <= _CROSSING_HALF_WIDTH_M for xy in _crossings(view))


def _breach(view: TrafficView, met: Encounter, kind: BreachKind, party: Party, text: str) -> Breach:
    """Return the breach as of the entry into the junction; of the contact where that was not seen."""
    step = met.collision.step if party.entered_step is None else party.entered_step
    return Breach(kind, party.row, view.time_s(step), text)
