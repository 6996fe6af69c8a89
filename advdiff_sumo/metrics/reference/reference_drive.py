"""Simulate a reference driver in the target's place, in a recorded encounter on any road.

UN Regulation No. 157 defines its models for a cut-in, a cut-out and a braking leader on a straight lane. Here the
same models (:mod:`.driver_models`) drive along the target's own way. They consider all road users that are, or will
soon be, in its corridor. ``docs/reference-drivers.md`` lists what this adds to the regulation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.errors import UnknownNameError
from advdiff_sumo.core.plan import Trajectory
from advdiff_sumo.core.record import EpisodeRecord
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches.conduct_rules import REVERSING_MPS
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.encounter import Encounter
from advdiff_sumo.metrics.kept_motion import velocity_mps
from advdiff_sumo.metrics.reference.corridor import (
    Corridor,
    Meeting,
    corridor_of,
    meeting_at,
    required_braking_mps2,
)
from advdiff_sumo.metrics.reference.drive_contact import Touch, least_gap_m, touches
from advdiff_sumo.metrics.reference.driver_models import HUMAN, MODELS, DriverModel
from advdiff_sumo.metrics.reference.others_paths import PERCEPTION_S, Prediction, predicted_motion
from advdiff_sumo.metrics.reference.own_way import OwnWay, joined_way, way_from
from advdiff_sumo.metrics.reference.reaction import Reaction, react
from advdiff_sumo.metrics.reference.record_tail import extended_tracks
from advdiff_sumo.metrics.reference.stop_duty import stop_demand

#: A reference driver takes over at most this long before the contact.
LOOKBACK_S = 5.0
#: The drive continues after the record's end until it stands, but at most for this long. The others keep their motion.
AFTER_S = 3.0
#: The takeover needs safe instants over at least this time before it.
_SAFE_FOR_S = 0.3
#: At up to 25 m/s, a stop line that full braking can no longer reach is passed within this time.
_PASSED_WITHIN_S = 2.0
#: The others' accelerations are measured over this time.
_ACCEL_OVER_S = 0.2
#: The target followed the lanes of its route if its centre was never farther from their way than this.
_ON_ROUTE_M = 0.4
#: Added to the distance within which others are considered.
_MARGIN_M = 30.0


@dataclass(frozen=True)
class ReferenceDrive:
    """One reference driver's drive from the takeover on; T instants at the record's step.

    Attributes:
        model: name of the model.
        takeover_step: instant of the record at which it takes over: the first of the T.
        states: (T,) its states; the first is the target's at the takeover. They continue after the record's end, by
            at most ``AFTER_S``, until it stands or has had its last collision. The others then keep their motion.
        accel_mps2: (T,) acceleration from each instant on.
        touches: its first contact with each road user with which it collides, in the order of time.
        spare_m: least gap to the other party of the collision; 0 on contact.
        spare_s: least time until it meets a road user ahead, extrapolated at each instant; at most ``PERCEPTION_S``.
    """

    model: str
    takeover_step: int
    states: Trajectory
    accel_mps2: FloatArray
    touches: tuple[Touch, ...]
    spare_m: float
    spare_s: float

    @property
    def contact_step(self) -> int | None:
        """Instant of the record before its first contact; None without one."""
        return self.touches[0].step if self.touches else None

    @property
    def contact_with(self) -> str | None:
        """Id of the road user with which it collides first; None without one."""
        return self.touches[0].name if self.touches else None

    @property
    def impact_mps(self) -> float:
        """Closing speed at its first contact; 0 without one."""
        return self.touches[0].closing_mps if self.touches else 0.0


def drive_reference(
    record: EpisodeRecord,
    road: RoadMap,
    collision: Collision | Encounter,
    model: str = HUMAN.name,
) -> ReferenceDrive:
    """Return the drive of the reference driver *model* in the target's place.

    It takes over at the last instant at which its own model calls the situation safe, at most ``LOOKBACK_S`` before
    the contact. If the target then passed a stop line at which it had to stop, it takes over before that. A pure
    function.

    Args:
        record: the episode.
        road: its map.
        collision: the target's collision, or the encounter it belongs to.
        model: a name of :data:`.driver_models.MODELS`.

    Raises:
        UnknownNameError: no such model.
    """
    return ReferenceDrivers(record, road, collision, LOOKBACK_S).drive(model)


class ReferenceDrivers:
    """All reference drivers in one encounter; what they perceive is computed once.

    Args:
        record: the episode.
        road: its map.
        collision: the target's collision, or the encounter it belongs to.
        lookback_s: longest time before the contact at which a driver takes over.
    """

    def __init__(
        self,
        record: EpisodeRecord,
        road: RoadMap,
        collision: Collision | Encounter,
        lookback_s: float = LOOKBACK_S,
    ) -> None:
        self._record, self._road = record, road
        hit = collision.collision if isinstance(collision, Encounter) else collision
        self._partner = hit.rows[1]
        dt = record.tracks.dt_s
        absent = np.flatnonzero(~record.tracks.valid[record.target, : hit.step + 1])
        earliest = int(absent[-1]) + 1 if absent.size else 0
        self._begin = max(hit.step - round(lookback_s / dt), min(earliest, hit.step))
        self._contact = hit.step
        self._tracks = extended_tracks(record.tracks, self._begin, round(AFTER_S / dt))

    def drive(self, model: str = HUMAN.name) -> ReferenceDrive:
        """Return the drive of *model*; see :func:`drive_reference`.

        Raises:
            UnknownNameError: no such model.
        """
        if model not in MODELS:
            raise UnknownNameError("reference driver", model, sorted(MODELS))
        driver = MODELS[model]
        start = self._takeover(driver)
        way = self._way_from_takeover(start)
        corridor = self._recorded_corridor if way is self._recorded_way else self._corridor_on(way)
        s, speed, accel, least_s = self._simulate(driver, way, corridor, start)
        return self._result(driver, start, way, s, speed, accel, least_s)

    def hardest_braking_mps2(self, model: str, instants: int) -> float:
        """Return the hardest braking of *model* in the first *instants* of a drive from the earliest takeover on."""
        _, _, accel, _ = self._simulate(MODELS[model], self._route_way, self._route_corridor, 0)
        return max(0.0, -float(accel[:instants].min()))

    # --- shared by all drivers ----------------------------------------------------------------------------

    @cached_property
    def _length_m(self) -> float:
        return float(self._tracks.size_m[self._record.target, 0])

    @cached_property
    def _span(self) -> int:
        """Number of instants from the earliest takeover to the contact."""
        return self._contact - self._begin + 1

    @cached_property
    def _rows(self) -> IntArray:
        """Rows of the others that are at some instant near enough to reach the target."""
        tracks, target, span = self._tracks, self._record.target, self._span
        top_mps = float(np.nanmax(np.abs(tracks.speed_mps[target, :span])))
        reach = _MARGIN_M + PERCEPTION_S * (top_mps + np.abs(tracks.speed_mps[:, :span]))
        offset = tracks.xy_m[:, :span] - tracks.xy_m[target, :span]
        with np.errstate(invalid="ignore"):
            near = np.asarray((np.hypot(offset[..., 0], offset[..., 1]) < reach).any(-1))
        near[target] = False
        return np.flatnonzero(near)

    @cached_property
    def _future(self) -> Prediction:
        back = max(1, round(_ACCEL_OVER_S / self._tracks.dt_s))
        speed = self._tracks.speed_mps[self._rows]
        first = np.repeat(speed[:, :1], back, axis=1)
        accel = (speed - np.concatenate((first, speed[:, :-back]), axis=1)) / (back * self._tracks.dt_s)
        return predicted_motion(self._road, self._tracks, self._rows, np.nan_to_num(accel))

    @cached_property
    def _route_way(self) -> OwnWay:
        """The way along the target's route from the earliest takeover on."""
        return way_from(self._record, self._road, self._begin, self._way_length_m)

    @cached_property
    def _route_corridor(self) -> Corridor:
        return self._corridor_on(self._route_way)

    @cached_property
    def _way_length_m(self) -> float:
        speed = self._tracks.speed_mps[self._record.target, : self._span]
        return float(np.nanmax(np.abs(speed))) * (PERCEPTION_S + 5.0) + 60.0

    @cached_property
    def _recorded_way(self) -> OwnWay:
        """The way of the recorded drive: that along the route if the target followed it, else the driven path."""
        _, d = self._route_way.line.project(self._tracks.xy_m[self._record.target, : self._span])
        if float(np.abs(d).max()) < _ON_ROUTE_M:
            return self._route_way
        return joined_way(self._record, self._road, self._begin, self._contact, self._way_length_m)

    @cached_property
    def _recorded_corridor(self) -> Corridor:
        if self._recorded_way is self._route_way:
            return self._route_corridor
        return self._corridor_on(self._recorded_way)

    def _corridor_on(self, way: OwnWay) -> Corridor:
        width = float(self._tracks.size_m[self._record.target, 1])
        return corridor_of(way, self._tracks, self._rows, self._future, width)

    def _way_from_takeover(self, start: int) -> OwnWay:
        if self._recorded_way is self._route_way or start == 0:
            return self._route_way
        return way_from(self._record, self._road, self._begin + start, self._way_length_m)

    # --- takeover ---------------------------------------------------------------------------------------

    @cached_property
    def _recorded_situations(self) -> list[tuple[Meeting, bool]]:
        """Relation of the target to the others at each instant up to the contact, and whether a line made it stop."""
        row, tracks, span = self._record.target, self._tracks, self._span
        s, _ = self._recorded_way.line.project(tracks.xy_m[row, :span])
        speed = tracks.speed_mps[row, :span]
        accel = np.diff(speed, prepend=speed[:1]) / tracks.dt_s
        situations = []
        for k in range(span):
            ego = float(s[k]), float(speed[k]), float(accel[k])
            meetings = meeting_at(self._recorded_corridor, k, ego, self._length_m)
            route_s_m = float(self._along_route_m[k])
            demand = self._stop_demand(self._route_way, route_s_m, float(speed[k]), k, meetings, False)
            situations.append((meetings, demand > 0.0))
        return situations

    @cached_property
    def _along_route_m(self) -> FloatArray:
        """Positions of the target along its route's lanes at each instant up to the contact."""
        return self._route_way.line.project(self._tracks.xy_m[self._record.target, : self._span])[0]

    @cached_property
    def _latest_takeover(self) -> int:
        """The last instant at which the target had to stop at a line that it then passed; without one, the contact.

        After that instant the line is too near to stop at and requires nothing, but that does not make it safe.
        """
        must_stop = np.array([must_stop for _, must_stop in self._recorded_situations])
        recent = round(_PASSED_WITHIN_S / self._tracks.dt_s)
        for path_link in self._route_way.links:
            passed = np.flatnonzero(self._along_route_m + 0.5 * self._length_m > path_link.s_m)
            before = np.flatnonzero(must_stop[: passed[0]]) if passed.size else passed
            if before.size and passed[0] - before[-1] <= recent:
                return int(before[-1])
        return len(must_stop) - 1

    def _takeover(self, driver: DriverModel) -> int:
        """Return the instant, counted from the earliest possible takeover, at which *driver* takes over."""
        reverses = self._tracks.speed_mps[self._record.target] < -REVERSING_MPS
        safe = [
            not must_stop
            and not reverses[k]
            and not self._is_beside(meetings)
            and not (required_braking_mps2(driver, meetings) > 0.0).any()
            for k, (meetings, must_stop) in enumerate(self._recorded_situations[: self._latest_takeover + 1])
        ]
        return _last_safe(np.array(safe), round(_SAFE_FOR_S / self._tracks.dt_s))

    def _is_beside(self, meetings: Meeting) -> bool:
        """Return whether the ego is beside the other party; the models call this safe, as braking does not help."""
        gap = meetings.situation.gap_m[self._rows == self._partner]
        lengths = meetings.situation.lengths_m[self._rows == self._partner]
        return bool(((gap <= 0.0) & (gap > -lengths)).any())

    # --- the drive --------------------------------------------------------------------------------------

    def _simulate(
        self, driver: DriverModel, way: OwnWay, corridor: Corridor, start: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return (T,) positions along the way, speeds and accelerations, and the least time to a meeting."""
        tracks, dt = self._tracks, self._tracks.dt_s
        steps = tracks.steps - start
        s, speed, accel = np.zeros(steps), np.zeros(steps), np.zeros(steps)
        s[0] = float(way.line.project(tracks.xy_m[self._record.target, start])[0])
        speed[0] = max(float(tracks.speed_mps[self._record.target, start]), 0.0)
        reaction, least_s, last_accel = Reaction.fresh(driver), PERCEPTION_S, 0.0
        for k in range(steps - 1):
            meetings = meeting_at(corridor, start + k, (s[k], speed[k], last_accel), self._length_m)
            reacting = bool(reaction.delay_left_s < driver.delay_s)
            demand = float(required_braking_mps2(driver, meetings, reacting).max(initial=0.0))
            demand = max(demand, self._stop_demand(way, s[k], speed[k], start + k, meetings, reacting))
            reaction, wanted_accel = react(reaction, driver, np.asarray(demand), dt)
            bend_mps = max(way.limit_mps(s[k]), speed[k] - 3.0 * dt)
            next_speed = min(max(speed[k] + float(wanted_accel) * dt, 0.0), bend_mps)
            ahead = meetings.inside | meetings.crossing
            least_s = min(least_s, float(meetings.meet_s[ahead].min(initial=PERCEPTION_S)))
            accel[k] = last_accel = (next_speed - speed[k]) / dt
            speed[k + 1], s[k + 1] = next_speed, s[k] + next_speed * dt
        return s, speed, accel, least_s

    def _stop_demand(
        self, way: OwnWay, s_m: float, speed_mps: float, instant: int, meetings: Meeting, braking: bool
    ) -> float:
        """Return the deceleration that the stop lines of *way* require at *s_m*; *instant* as of ``_takeover``."""
        if not way.links:
            return 0.0
        signals = self._record.signals
        step = min(self._begin + instant, len(signals) - 1)
        return stop_demand(
            self._road,
            way.links,
            s_m + 0.5 * self._length_m,
            speed_mps,
            signals[step] if signals else {},
            self._future.links,
            meetings.conflict,
            braking,
        )

    def _result(
        self,
        driver: DriverModel,
        start: int,
        way: OwnWay,
        s: FloatArray,
        speed: FloatArray,
        accel: FloatArray,
        least_s: float,
    ) -> ReferenceDrive:
        tracks, row = self._tracks, self._record.target
        xy, yaw = way.poses(s)
        yaw[0] = tracks.yaw_rad[row, start]
        first = self._begin + start
        drive, others = Trajectory(xy, yaw, speed, tracks.dt_s), tracks.window(start, tracks.steps)
        contacts = touches(drive, others, row, first)
        hits_partner = any(contact.name == tracks.ids[self._partner] for contact in contacts)
        until_standing = self._steps_until_standing(speed, start)
        length = until_standing
        if contacts:
            length = min(len(speed), max(self._record.tracks.steps - first, contacts[-1].step - first + 2))
        return ReferenceDrive(
            model=driver.name,
            takeover_step=first,
            states=drive.mapped(lambda part: part[:length]),
            accel_mps2=accel[:length],
            touches=contacts,
            spare_m=0.0 if hits_partner else least_gap_m(drive, others, row, self._partner, until_standing),
            spare_s=0.0 if hits_partner else least_s,
        )

    def _steps_until_standing(self, speed: FloatArray, start: int) -> int:
        """Return the number of instants of the drive: those of the record, and then until it stands."""
        recorded = self._record.tracks.steps - self._begin - start
        standing = np.flatnonzero(speed[recorded - 1 :] <= 0.0)
        return recorded + int(standing[0]) if standing.size else len(speed)


def _last_safe(safe: BoolArray, count: int) -> int:
    """Return the last instant that ends *count* safe ones; fewer suffice from the first instant on. 0 without one."""
    for k in range(len(safe) - 1, -1, -1):
        if safe[k] and safe[max(0, k - count + 1) : k + 1].all():
            return k
    return 0


def drive_all(
    record: EpisodeRecord,
    road: RoadMap,
    collision: Collision | Encounter,
    lookback_s: float = LOOKBACK_S,
) -> dict[str, ReferenceDrive]:
    """Return :func:`drive_reference` for every model; what they perceive is computed once.

    They take over at most *lookback_s* before the contact.
    """
    drivers = ReferenceDrivers(record, road, collision, lookback_s)
    return {model: drivers.drive(model) for model in MODELS}


def instant_as_collision(record: EpisodeRecord, row: int, step: int) -> Collision:
    """Return an instant of an encounter with *row* as a collision, the form that :class:`ReferenceDrivers` takes."""
    tracks, rows = record.tracks, [record.target, row]
    offset = tracks.xy_m[row, step] - tracks.xy_m[record.target, step]
    return Collision(
        rows=(record.target, row),
        step=step,
        fraction=0.0,
        time_s=tracks.t0_s + step * tracks.dt_s,
        point_m=tracks.xy_m[record.target, step] + 0.5 * offset,
        penetration_m=0.0,
        initial=False,
        xy_m=tracks.xy_m[rows, step],
        yaw_rad=tracks.yaw_rad[rows, step],
        velocity_mps=np.stack([velocity_mps(tracks, x, step) for x in rows]),
        normal=offset / max(float(np.hypot(*offset)), 1e-9),
        faces=("front", "rear"),
    )
