"""Define everything that an episode is made of: scene, planner, policy, duration."""

from __future__ import annotations

from dataclasses import dataclass, field

from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.planners.planner_protocol import Target
from advdiff_sumo.sim.heartbeat import Heartbeat
from advdiff_sumo.sim.plan_memo import PlanMemo
from advdiff_sumo.sim.seed_scene import SavedTraffic, SeedScene
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.traffic.policy_protocol import TrafficPolicy, moves_everywhere


@dataclass(frozen=True)
class EpisodeSetup:
    """Everything that one episode is made of.

    Attributes:
        number: in its run.
        scene: where it starts.
        road: the map.
        target: what drives the tested vehicle.
        policy: what moves the background vehicles.
        names: of target and background, for messages.
        sim: steps and radii.
        horizon_s: longest duration.
        seed: the episode's node of the seed tree.
        gui: open sumo-gui.
        heartbeat: receives each phase and step.
        memo: plans of the policy that this process has made before; None: each plan is made.
    """

    number: int
    scene: SeedScene
    road: RoadMap
    target: Target
    policy: TrafficPolicy
    names: tuple[str, str]
    sim: SimOptions
    horizon_s: float
    seed: SeedTree
    gui: bool = field(default=False)
    heartbeat: Heartbeat = field(default_factory=Heartbeat)
    memo: PlanMemo | None = field(default=None)

    @property
    def steps(self) -> int:
        """Largest number of SUMO steps."""
        longest = self.horizon_s
        if not isinstance(self.scene.start, SavedTraffic) or moves_everywhere(self.policy):
            longest = min(longest, self.scene.horizon_s)
        return round(longest / self.sim.step_s)
