"""Background that SUMO's own driver models move."""

from __future__ import annotations

from typing import TYPE_CHECKING

from advdiff_sumo.core.plan import JointPlan
from advdiff_sumo.core.scene import Scene, Tracks

if TYPE_CHECKING:
    import numpy as np

    from advdiff_sumo.maps import RoadMap
    from advdiff_sumo.traffic.policy_protocol import TrafficPolicy


class SumoTraffic:
    """Moves no vehicle: SUMO drives the whole background."""

    def start(self, road: RoadMap, scene: Scene, log: Tracks | None, rng: np.random.Generator) -> None:
        """Return no memory."""

    def plan(
        self,
        road: RoadMap,  # noqa: ARG002 - the contract
        scene: Scene,
        memory: None,  # noqa: ARG002 - the contract
        rng: np.random.Generator,  # noqa: ARG002 - the contract
    ) -> tuple[JointPlan, None]:
        """Return a plan of no vehicles, one model step long."""
        dt_s = scene.history.dt_s
        return JointPlan(Tracks.empty(steps=1, dt_s=dt_s, t0_s=scene.time_s + dt_s)), None


def plans_nothing(policy: TrafficPolicy) -> bool:
    """Return whether *policy* moves no vehicle, as its ``plan`` is that of :class:`SumoTraffic`."""
    return getattr(type(policy), "plan", None) is SumoTraffic.plan
