"""The background policy ``diffusion``: encode, sample with guidance, decode, keep it plausible (Alg. 1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np

from advdiff_sumo.core.arrays import BoolArray, FloatArray, IntArray
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.plan import AttackState, JointPlan
from advdiff_sumo.core.scene import MOTOR_CLASSES, Scene, Tracks
from advdiff_sumo.core.threads import one_thread
from advdiff_sumo.models.model_options import MODEL_STEP_S
from advdiff_sumo.models.view import View, look
from advdiff_sumo.traffic.diffusion.diffusion_networks import Networks, networks_of
from advdiff_sumo.traffic.diffusion.diffusion_options import DiffusionOptions, Traj2TrajOptions
from advdiff_sumo.traffic.manoeuvres.commitments import Commitments, let_in
from advdiff_sumo.traffic.manoeuvres.licence import NATURAL_OVER_LIMIT
from advdiff_sumo.traffic.manoeuvres.licensed_attack import RECKLESS, LicensedAttack, licensed_attack
from advdiff_sumo.traffic.manoeuvres.situation_view import SituationView
from advdiff_sumo.traffic.manoeuvres.staging import Newcomer, plan_with
from advdiff_sumo.traffic.planning.draw import Drawn, draw_plan
from advdiff_sumo.traffic.planning.futures import Futures, coasting, futures_of, join
from advdiff_sumo.traffic.planning.lanes_ahead import LaneAhead, lanes_ahead
from advdiff_sumo.traffic.planning.people import PEOPLE, go_straight, velocities
from advdiff_sumo.traffic.planning.safeguard import Guarded, Plan, Watched, back_to_lane, safeguard
from advdiff_sumo.traffic.planning.way_out import way_out

if TYPE_CHECKING:
    from advdiff_sumo.maps import RoadMap

_LEAVES_M, _LEAVES_S = 12.0, 2.0
_STANDS_MPS, _WALKS_MPS, _SLIPPED_M = 0.2, 2.0, 0.3

Listener: TypeAlias = Callable[[View, Drawn], None]


@dataclass(frozen=True)
class Memory:
    """What a policy remembers from plan to plan.

    Attributes:
        noise: id → starting noise of the vehicle, (Z,).
        shifts: id of who was guided last → what its latent was shifted by, (Z,).
        plan: the last plan, at its own clock.
        driven: model steps of it that have been driven when the next plan is asked for.
        commitments: manoeuvres under way; None where the licence asks for none.
    """

    noise: Mapping[str, FloatArray] = field(default_factory=dict)
    shifts: Mapping[str, FloatArray] = field(default_factory=dict)
    plan: Tracks | None = None
    driven: int = 0
    commitments: Commitments | None = None


class DiffusionTraffic:
    """Moves the background by guided latent diffusion; options are those of :class:`DiffusionOptions`.

    Vehicles that come to where the road ends are left to SUMO, which takes them off the net.

    Attributes:
        options: checked.
        networks: the trained networks.
        listener: told of every plan that is drawn; for warm-up and for measurements.
    """

    Options: ClassVar[type[DiffusionOptions]] = DiffusionOptions
    name: ClassVar[str] = "diffusion"
    _rehearsed: ClassVar[bool] = False

    def __init__(self, **options: Any) -> None:
        """Check the options and read the networks.

        Raises:
            ConfigError: an option has no such name or value.
            WeightsError: the networks are missing or unusable.
        """
        self.options = self.Options.parse(options, f"options of background '{self.name}'")
        self.networks: Networks = networks_of(self.options)
        self.listener: Listener | None = None

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> Memory:  # noqa: ARG002 - the contract
        """Return an empty memory, and let the map make its table of pieces."""
        _ = road.pieces
        memory = Memory()
        if self.options.licence != "reckless" and self.options.guided:
            memory = Memory(commitments=Commitments.start(self.options.manoeuvre, rng, self.options.staged))
        if not self._rehearsed:
            self._rehearse(road, scene, memory)
        return memory

    def _rehearse(self, road: RoadMap, scene: Scene, memory: Memory) -> None:
        """Make a plan for nothing, once a process: what is set up with the first one is in no plan's time then."""
        DiffusionTraffic._rehearsed = True
        listener, self.listener = self.listener, None
        self.plan(road, scene, memory, np.random.default_rng(0))
        self.listener = listener

    @one_thread()
    def plan(
        self, road: RoadMap, scene: Scene, memory: Memory, rng: np.random.Generator
    ) -> tuple[JointPlan, Memory]:
        """Return the futures of all movable vehicles, 6 s at 2 Hz, and the memory for the next plan."""
        kept = rest_of(memory.plan, memory.driven, scene, self.options.replan)
        if kept is not None:
            return JointPlan(kept), replace(memory, driven=memory.driven + 1)
        return self._afresh(road, scene, memory, rng)

    def _afresh(
        self, road: RoadMap, scene: Scene, memory: Memory, rng: np.random.Generator
    ) -> tuple[JointPlan, Memory]:
        lanes = self._lanes(road, scene)
        view = look(road, scene, leaving(scene, lanes))
        seed = int(rng.integers(2**62))
        if not view.moved.any():
            return self._alone(road, scene, memory)
        drawn = draw_plan(self.networks, self.options, view, memory.noise, memory.shifts, seed)
        if self.listener is not None:
            self.listener(view, drawn)
        attack = self._attack(road, view, drawn, memory)
        guarded = apply_safeguard(road, view, drawn, lanes, (memory.plan, memory.driven), attack)
        tracks = tracks_of(view, guarded.futures)
        state = self._state(drawn.attackers, attack.commitments)
        memory = Memory(drawn.noise, drawn.shifts, tracks, 1, attack.commitments)
        return plan_with(tracks, attack.newcomers, state), memory

    def _state(self, guided: Sequence[str], commitments: Commitments | None) -> AttackState | None:
        """Return who is in a position for the attack: who is guided to it, or drives a manoeuvre of its kind."""
        if not self.options.guided:
            return None
        asked, term = self.options.attack, self.options.attack_term
        aimed = guided if asked == "any" or term != "any" else ()  # the guide has no term of this kind
        driving = () if commitments is None else commitments.attacking
        return AttackState(asked, tuple(dict.fromkeys((*aimed, *driving))))

    def _alone(self, road: RoadMap, scene: Scene, memory: Memory) -> tuple[JointPlan, Memory]:
        """Return the plan where nobody may be moved: of who comes in, if anybody."""
        empty = Tracks.empty(steps=1, dt_s=MODEL_STEP_S, t0_s=scene.time_s + MODEL_STEP_S)
        kept, newcomers = memory.commitments, tuple[Newcomer, ...]()
        if kept is not None:
            newcomers, kept = let_in(SituationView.of(road, scene), kept)
        plan = plan_with(empty, newcomers, self._state((), None))
        return plan, replace(memory, plan=None, commitments=kept)

    def _attack(self, road: RoadMap, view: View, drawn: Drawn, memory: Memory) -> LicensedAttack:
        """Return what the licence makes of the plan *drawn*."""
        if not self.options.guided:
            return RECKLESS
        futures = futures_of(view.now, drawn.rollout)
        licence, most = self.options.licence, self.options.attackers
        return licensed_attack(road, view, futures, drawn.attackers, licence, memory.commitments, most)

    def _lanes(self, road: RoadMap, scene: Scene) -> dict[int, LaneAhead | None]:
        return lanes_of(road, scene)


class Traj2Traj(DiffusionTraffic):
    """The paper's ablation in closed loop: trajectories are diffused, without decoder, bicycle model or guide."""

    Options: ClassVar[type[DiffusionOptions]] = Traj2TrajOptions
    name: ClassVar[str] = "traj2traj"


def lanes_of(road: RoadMap, scene: Scene) -> dict[int, LaneAhead | None]:
    """Return the lanes that each movable vehicle, by its row, would follow."""
    rows = np.flatnonzero(scene.movable & scene.history.valid[:, -1])
    now = scene.history
    found = lanes_ahead(
        road, now.xy_m[rows, -1], now.yaw_rad[rows, -1], [scene.routes[row] for row in rows.tolist()]
    )
    return dict(zip(rows.tolist(), found, strict=True))


def apply_safeguard(
    road: RoadMap,
    view: View,
    drawn: Drawn,
    lanes: Mapping[int, LaneAhead | None],
    before: tuple[Tracks | None, int] = (None, 0),
    attack: LicensedAttack = RECKLESS,
) -> Guarded:
    """Return the plans *drawn* for *view* made plausible, among everybody else's predictions.

    Args:
        road: the map.
        view: the scene.
        drawn: the plans.
        lanes: what each movable vehicle, by its row in the scene, would follow.
        before: the last plan and how many model steps of it have been driven.
        attack: what the licence makes of the attackers.
    """
    seen, scene = futures_of(view.now, drawn.rollout), view.scene
    rest = np.setdiff1d(np.flatnonzero(scene.history.valid[:, -1]), view.rows)
    rows = np.concatenate((view.rows, rest))
    watched = _watched(road, view, rows, lanes, drawn.attackers, attack)
    watched = replace(watched, before=rests(*before, view, seen.steps))
    for row, plan in attack.driven.items():
        seen.put(row, *plan)
    back_to_lane(seen, np.array(attack.refused, dtype=np.int64), watched)
    now = scene.history
    joined = join(
        seen,
        coasting(
            now.xy_m[rest, -1],
            now.yaw_rad[rest, -1],
            now.speed_mps[rest, -1],
            now.size_m[rest],
            seen.steps,
            seen.dt_s,
        ),
    )
    go_straight(joined, watched.people & ~_with_rest(view.moved, rest), velocities(now)[rows])
    return safeguard(road, joined, watched)


def _watched(
    road: RoadMap,
    view: View,
    rows: IntArray,
    lanes: Mapping[int, LaneAhead | None],
    attackers: Sequence[str],
    attack: LicensedAttack,
) -> Watched:
    """Return what the safeguard has to know of *rows* (N,) of the scene, those of the view first."""
    scene, rest = view.scene, rows[len(view.ids) :]
    guided = np.isin(view.ids, attackers)
    planned = view.moved & ~np.isin(np.arange(len(view.ids)), list(attack.driven))
    dawdled = _slower(view.now, _WALKS_MPS)
    ahead = [lanes.get(row) for row in rows.tolist()]
    for row in np.flatnonzero(planned & dawdled).tolist():
        if ahead[row] is None:
            ahead[row] = way_out(road, view.now.xy_m[row, -1], float(view.now.yaw_rad[row, -1]))
    over_limit = np.where(guided, attack.over_limit, NATURAL_OVER_LIMIT)
    return Watched(
        planned=_with_rest(planned, rest),
        attacker=_with_rest(guided & attack.exempt, rest),
        target=0,
        motor=np.isin(scene.history.classes[rows], MOTOR_CLASSES),
        people=np.isin(scene.history.classes[rows], PEOPLE),
        stood=_with_rest(_slower(view.now, _STANDS_MPS), rest),
        dawdled=_with_rest(dawdled, rest),
        over_limit=np.concatenate((over_limit, np.ones(len(rest)))),
        lanes=ahead,
        signals=scene.signals,
    )


def _with_rest(mask: BoolArray, rest: IntArray) -> BoolArray:
    """Return *mask* of the view's agents, and False for the *rest* of the scene."""
    return np.concatenate((mask, np.zeros(len(rest), dtype=np.bool_)))


def rests(plan: Tracks | None, driven: int, view: View, steps: int) -> dict[int, Plan]:
    """Return by row of *view* what is left of the last plan, gone on with at its last speed, for *steps* instants.

    Who is not where its plan had it by now is left out.
    """
    if plan is None or not 0 < driven < plan.steps:
        return {}
    rest = {name: row for row, name in enumerate(plan.ids)}
    ahead = np.arange(driven, driven + steps)
    index, beyond = np.minimum(ahead, plan.steps - 1), plan.dt_s * np.maximum(ahead - plan.steps + 1, 0)
    out: dict[int, Plan] = {}
    for row in np.flatnonzero(view.moved).tolist():
        mine = rest.get(view.ids[row])
        if mine is None:
            continue
        if np.linalg.norm(plan.xy_m[mine, driven - 1] - view.now.xy_m[row, -1]) < _SLIPPED_M:
            yaw, speed = plan.yaw_rad[mine, index], plan.speed_mps[mine, index]
            out[row] = plan.xy_m[mine, index] + (speed * beyond)[:, None] * unit(yaw), yaw, speed
    return out


def _slower(now: Tracks, speed_mps: float) -> BoolArray:
    """Return (A,) who has been there, slower than *speed_mps*, for the whole history."""
    return np.asarray((now.valid & (np.abs(now.speed_mps) < speed_mps)).all(axis=1))


def leaving(scene: Scene, lanes: Mapping[int, LaneAhead | None]) -> BoolArray:
    """Return (agents,) which vehicles are about to drive off the net's end."""
    out = np.zeros(scene.history.agents, dtype=np.bool_)
    for row, lane in lanes.items():
        if lane is not None:
            speed = max(float(scene.history.speed_mps[row, -1]), 0.0)
            out[row] = lane.end_m < _LEAVES_M + _LEAVES_S * speed
    return out


def tracks_of(view: View, futures: Futures) -> Tracks:
    """Return the plans of the moved vehicles."""
    rows = np.flatnonzero(view.moved)
    now = view.now.rows(rows)
    return Tracks(
        ids=now.ids,
        classes=now.classes,
        size_m=now.size_m,
        xy_m=futures.xy_m[rows, 1:],
        yaw_rad=futures.yaw_rad[rows, 1:],
        speed_mps=futures.speed_mps[rows, 1:],
        valid=np.ones((len(rows), futures.steps), dtype=np.bool_),
        t0_s=view.scene.time_s + futures.dt_s,
        dt_s=futures.dt_s,
    )


def rest_of(plan: Tracks | None, driven: int, scene: Scene, replan: int) -> Tracks | None:
    """Return what is left of the last plan, where it shall be driven on and names everybody that may be moved.

    Args:
        plan: the last one.
        driven: model steps of it that have been driven.
        scene: now.
        replan: model steps of a plan to drive.
    """
    if plan is None or driven >= replan or plan.steps <= driven:
        return None
    late = abs(plan.t0_s + (driven - 1) * plan.dt_s - scene.time_s) > 1e-6
    movable = {name for name, free in zip(scene.history.ids, scene.movable, strict=True) if free}
    if late or movable != set(plan.ids):
        return None
    return plan.window(driven, plan.steps)
