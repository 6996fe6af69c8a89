"""Measure the overhead of a call of a remote planner, with 30 other road users.

Usage: python tools/bench_remote.py [PLANS]
"""

from __future__ import annotations

import sys
import time

import numpy as np

from advdiff_sumo.core.plan import Controls
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.planners.planner_check import planning_times_s
from advdiff_sumo.planners.remote.remote_planner import RemoteOptions, RemotePlanner

_OTHERS, _HISTORY_STEPS = 30, 5


class Coast:
    """A planner that keeps its speed and needs microseconds for a plan."""

    def start(self, road: object, scene: Scene, rng: np.random.Generator) -> None:
        """Return None, since there is nothing to remember."""

    def plan(
        self, road: object, scene: Scene, memory: None, rng: np.random.Generator
    ) -> tuple[Controls, None]:
        """Return 4 s without acceleration or steering."""
        del road, scene, memory, rng
        return Controls(np.zeros(40), np.zeros(40), 0.1), None


def crowd() -> Scene:
    """Return the target and 30 other cars in a row."""
    agents = _OTHERS + 1
    shape = agents, _HISTORY_STEPS
    x = np.arange(agents)[:, None] * 10.0 + np.arange(_HISTORY_STEPS) * 4.0
    history = Tracks(
        ids=tuple(f"car{k}" for k in range(agents)),
        classes=np.zeros(agents, dtype=np.int64),
        size_m=np.tile((4.6, 1.8), (agents, 1)),
        xy_m=np.stack((x, np.zeros(shape)), axis=-1),
        yaw_rad=np.zeros(shape),
        speed_mps=np.full(shape, 8.0),
        valid=np.ones(shape, dtype=np.bool_),
        t0_s=-2.0,
        dt_s=0.5,
    )
    routes = (tuple(f"edge{k}" for k in range(20)), *[()] * _OTHERS)
    return Scene(
        history, 0, np.zeros(agents, dtype=np.bool_), routes, {f"light{k}": "GrGr" for k in range(20)}
    )


def main() -> None:
    """Print the median and the 99 % quantile of the time of a call."""
    plans = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    road, scene = RoadMap.read(find_net("downtown")), crowd()
    planner = RemotePlanner(
        f"exec:{sys.executable} -m advdiff_sumo.planner_kit tools.bench_remote:Coast", RemoteOptions()
    )
    start = time.perf_counter()
    planning_times_s(planner, road, scene, 1)
    print(
        f"first plan, with the server's start and the map of {road.name}: {time.perf_counter() - start:.2f} s"
    )
    times_ms = 1e3 * planning_times_s(planner, road, scene, plans)
    p50, p99 = np.quantile(times_ms, (0.5, 0.99))
    print(f"{plans} plans with {_OTHERS} others: median {p50:.2f} ms, 99 % {p99:.2f} ms")
    planner.close()


if __name__ == "__main__":
    main()
