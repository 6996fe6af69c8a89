"""What a reference driver would have done in the target's place, in a recorded encounter on any road.

UN Regulation No. 157 defines its models for a cut-in, a cut-out and a braking leader on a straight lane. Here the
same models (:mod:`.driver_models`) drive along the target's own way and look at everybody who is, or is about to be,
in its corridor. What that adds to the regulation stands in ``docs/reference-drivers.md``.
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
from advdiff_sumo.metrics.collision import Collision
from advdiff_sumo.metrics.encounter import Encounter
from advdiff_sumo.metrics.reference.corridor import Corridor, Meeting, corridor_of, demands, meeting
from advdiff_sumo.metrics.reference.drive_contact import Touch, least_gap_m, touches
from advdiff_sumo.metrics.reference.driver_models import HUMAN, MODELS, DriverModel
from advdiff_sumo.metrics.reference.others_paths import PERCEPTION_S, Expected, expected
from advdiff_sumo.metrics.reference.own_way import OwnWay, joined_way, way_from
from advdiff_sumo.metrics.reference.reaction import Reaction, react
from advdiff_sumo.metrics.reference.record_tail import extended
from advdiff_sumo.metrics.reference.stop_duty import stop_demand

#: A reference driver takes over at most this long before the contact.
LOOKBACK_S = 5.0
#: The drive goes on for so long after the record's end, or until it stands: the others keep their motion.
AFTER_S = 3.0
_SAFE_SPELL_S = 0.3
#: Full braking from up to 25 m/s ends within this time.
_BOUND_S = 2.0
_ACCEL_OVER_S = 0.2
_SAME_WAY_M = 0.4
_MARGIN_M = 30.0


@dataclass(frozen=True)
class ReferenceDrive:
    """One reference driver's drive from the takeover on; T instants at the record's step.

    Attributes:
        model: name of the model.
        takeover_step: instant of the record at which it takes over: the first of the T.
        states: (T,) its states, the first of which is the target's at the takeover. They reach beyond the record's
            end until it stands, or has met the last of those whom it runs into, at most ``AFTER_S``; the others go on
            as they last did.
        accel_mps2: (T,) acceleration from each instant on.
        touches: its first contact with each of those with whom it collides, in their order.
        spare_m: least gap to the other party of the collision; 0 on contact.
        spare_s: least time in which it would have met anybody ahead had all gone on as they did, at most
            ``PERCEPTION_S``.
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
        """Instant (of the record's count) before its first contact with anybody; None without one."""
        return self.touches[0].step if self.touches else None

    @property
    def contact_with(self) -> str | None:
        """Id of who it collides with first."""
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
    the contact; where the target drove past a stop line that binds, before that. A pure function.

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
    """All reference drivers in one encounter; what they perceive is worked out once.

    Args:
        record: the episode.
        road: its map.
        collision: the target's collision, or the encounter it belongs to.
        lookback_s: how long before the contact a driver takes over at the earliest.
    """

    def __init__(
        self,
        record: EpisodeRecord,
        road: RoadMap,
        collision: Collision | Encounter,
        lookback_s: float = LOOKBACK_S,
    ) -> None:
        self._record, self._road = record, road
        met = collision.collision if isinstance(collision, Encounter) else collision
        self._partner = met.rows[1]
        dt = record.tracks.dt_s
        there = record.tracks.valid[record.target, : met.step + 1]
        absent = np.flatnonzero(~there)
        earliest = int(absent[-1]) + 1 if absent.size else 0
        self._begin = max(met.step - round(lookback_s / dt), min(earliest, met.step))
        self._contact = met.step
        self._tracks = extended(record.tracks, self._begin, round(AFTER_S / dt))

    def drive(self, model: str = HUMAN.name) -> ReferenceDrive:
        """Return the drive of *model*; see :func:`drive_reference`.

        Raises:
            UnknownNameError: no such model.
        """
        if model not in MODELS:
            raise UnknownNameError("reference driver", model, sorted(MODELS))
        driver = MODELS[model]
        start = self._takeover(driver)
        way = self._way_at(start)
        corridor = self._corridor if way is self._way else self._corridor_on(way)
        s, speed, accel, least_s = self._follow(driver, way, corridor, start)
        return self._result(driver, start, way, s, speed, accel, least_s)

    # --- what all drivers share -------------------------------------------------------------------------

    @cached_property
    def _length_m(self) -> float:
        return float(self._tracks.size_m[self._record.target, 0])

    @cached_property
    def _rows(self) -> IntArray:
        """Whoever may come near the target: the others that are within reach of it at some instant."""
        tracks, target = self._tracks, self._record.target
        span = self._contact - self._begin + 1
        top = float(np.nanmax(np.abs(tracks.speed_mps[target, :span])))
        reach = _MARGIN_M + PERCEPTION_S * (top + np.abs(tracks.speed_mps[:, :span]))
        offset = tracks.xy_m[:, :span] - tracks.xy_m[target, :span]
        with np.errstate(invalid="ignore"):
            near = np.asarray((np.hypot(offset[..., 0], offset[..., 1]) < reach).any(-1))
        near[target] = False
        return np.flatnonzero(near)

    @cached_property
    def _future(self) -> Expected:
        back = max(1, round(_ACCEL_OVER_S / self._tracks.dt_s))
        speed = self._tracks.speed_mps[self._rows]
        first = np.repeat(speed[:, :1], back, axis=1)
        accel = (speed - np.concatenate((first, speed[:, :-back]), axis=1)) / (back * self._tracks.dt_s)
        return expected(self._road, self._tracks, self._rows, np.nan_to_num(accel))

    @cached_property
    def _route_way(self) -> OwnWay:
        return way_from(self._record, self._road, self._begin, self._reach_m)

    @cached_property
    def _reach_m(self) -> float:
        speed = self._tracks.speed_mps[self._record.target, : self._contact - self._begin + 1]
        return float(np.nanmax(np.abs(speed))) * (PERCEPTION_S + 5.0) + 60.0

    @cached_property
    def _way(self) -> OwnWay:
        """The way of the recorded drive: its route's lanes from the earliest takeover on, if it kept to them."""
        span = self._contact - self._begin + 1
        _, d = self._route_way.line.project(self._tracks.xy_m[self._record.target, :span])
        if float(np.abs(d).max()) < _SAME_WAY_M:
            return self._route_way
        return joined_way(self._record, self._road, self._begin, self._contact, self._reach_m)

    @cached_property
    def _corridor(self) -> Corridor:
        return self._corridor_on(self._way)

    def _corridor_on(self, way: OwnWay) -> Corridor:
        width = float(self._tracks.size_m[self._record.target, 1])
        return corridor_of(way, self._tracks, self._rows, self._future, width)

    def _way_at(self, start: int) -> OwnWay:
        if self._way is self._route_way or start == self._begin:
            return self._route_way
        return way_from(self._record, self._road, self._begin + start, self._reach_m)

    # --- takeover ---------------------------------------------------------------------------------------

    @cached_property
    def _recorded(self) -> list[tuple[Meeting, bool]]:
        """How the target stood to everybody at each instant up to the contact, and whether a stop line bound it."""
        span = self._contact - self._begin + 1
        row, tracks = self._record.target, self._tracks
        s, _ = self._way.line.project(tracks.xy_m[row, :span])
        speed = tracks.speed_mps[row, :span]
        accel = np.diff(speed, prepend=speed[:1]) / tracks.dt_s
        contacts = []
        for k in range(span):
            ego = float(s[k]), float(speed[k]), float(accel[k])
            met = meeting(self._corridor, k, ego, self._length_m)
            place = float(self._along_route_m[k])
            bound = self._stop_demand(self._route_way, place, float(speed[k]), k, met, False) > 0.0
            contacts.append((met, bound))
        return contacts

    @cached_property
    def _along_route_m(self) -> FloatArray:
        """Places of the target along its route's lanes at each instant up to the contact."""
        span = self._contact - self._begin + 1
        return self._route_way.line.project(self._tracks.xy_m[self._record.target, :span])[0]

    @cached_property
    def _latest(self) -> int:
        """The last instant at which a stop line bound the target that it then passed; that of the contact without one.

        From there on the line is too near to stop at and binds no more, which does not make it harmless.
        """
        bound = np.array([bound for _, bound in self._recorded])
        recent = round(_BOUND_S / self._tracks.dt_s)
        for place in self._route_way.links:
            over = np.flatnonzero(self._along_route_m + 0.5 * self._length_m > place.s_m)
            before = np.flatnonzero(bound[: over[0]]) if over.size else over
            if before.size and over[0] - before[-1] <= recent:
                return int(before[-1])
        return len(bound) - 1

    def _takeover(self, driver: DriverModel) -> int:
        """Return the instant after the earliest one at which *driver* takes over."""
        safe = [
            not (bound or self._beside(met) or bool((demands(driver, met) > 0.0).any()))
            for met, bound in self._recorded[: self._latest + 1]
        ]
        return _last_safe(np.array(safe), round(_SAFE_SPELL_S / self._tracks.dt_s))

    def _beside(self, met: Meeting) -> bool:
        """Return whether the ego is beside the other party, where models call it safe as braking is of no use."""
        gap = met.situation.gap_m[self._rows == self._partner]
        lengths = met.situation.lengths_m[self._rows == self._partner]
        return bool(((gap <= 0.0) & (gap > -lengths)).any())

    # --- the drive --------------------------------------------------------------------------------------

    def _follow(
        self, driver: DriverModel, way: OwnWay, corridor: Corridor, start: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return (T,) places along the way, speeds and accelerations, and the least time to a meeting."""
        tracks, dt = self._tracks, self._tracks.dt_s
        steps = tracks.steps - start
        s, speed, accel = np.zeros(steps), np.zeros(steps), np.zeros(steps)
        s[0] = float(way.line.project(tracks.xy_m[self._record.target, start])[0])
        speed[0] = max(float(tracks.speed_mps[self._record.target, start]), 0.0)
        reaction, least, before = Reaction.fresh(driver), PERCEPTION_S, 0.0
        for k in range(steps - 1):
            met = meeting(corridor, start + k, (s[k], speed[k], before), self._length_m)
            braking = bool(reaction.delay_left_s < driver.delay_s)
            demand = float(demands(driver, met, braking).max(initial=0.0))
            demand = max(demand, self._stop_demand(way, s[k], speed[k], start + k, met, braking))
            reaction, push = react(reaction, driver, np.asarray(demand), dt)
            after = min(max(speed[k] + float(push) * dt, 0.0), max(way.limit_mps(s[k]), speed[k] - 3.0 * dt))
            least = min(least, float(met.meet_s[met.inside | met.crossing].min(initial=PERCEPTION_S)))
            accel[k] = before = (after - speed[k]) / dt
            speed[k + 1], s[k + 1] = after, s[k] + after * dt
        return s, speed, accel, least

    def _stop_demand(
        self, way: OwnWay, s_m: float, speed_mps: float, instant: int, met: Meeting, braking: bool
    ) -> float:
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
            met.conflict,
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
        touched = touches(drive, others, row, first)
        hit = any(touch.name == tracks.ids[self._partner] for touch in touched)
        stands = self._until_standing(speed, start)
        kept = stands
        if touched:
            kept = min(len(speed), max(self._record.tracks.steps - first, touched[-1].step - first + 2))
        return ReferenceDrive(
            model=driver.name,
            takeover_step=first,
            states=drive.mapped(lambda part: part[:kept]),
            accel_mps2=accel[:kept],
            touches=touched,
            spare_m=0.0 if hit else least_gap_m(drive, others, row, self._partner, stands),
            spare_s=0.0 if hit else least_s,
        )

    def _until_standing(self, speed: FloatArray, start: int) -> int:
        """Return how many instants the drive lasts: those of the record, and on until it stands."""
        recorded = self._record.tracks.steps - self._begin - start
        standing = np.flatnonzero(speed[recorded - 1 :] <= 0.0)
        return recorded + int(standing[0]) if standing.size else len(speed)


def _last_safe(safe: BoolArray, spell: int) -> int:
    """Return the last safe instant, of a stretch of at least *spell* ones unless it begins at the first; else 0."""
    at = len(safe) - 1
    while at >= 0:
        if safe[at] and safe[max(0, at - spell + 1) : at + 1].all():
            return at
        at -= 1
    return 0


def drive_all(
    record: EpisodeRecord,
    road: RoadMap,
    collision: Collision | Encounter,
    lookback_s: float = LOOKBACK_S,
) -> dict[str, ReferenceDrive]:
    """Return :func:`drive_reference` for every model, what they perceive worked out once.

    They take over at most *lookback_s* before the contact.
    """
    drivers = ReferenceDrivers(record, road, collision, lookback_s)
    return {model: drivers.drive(model) for model in MODELS}
