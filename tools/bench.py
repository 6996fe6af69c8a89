"""Compare the speed of the episode loop with that of a bare libsumo loop: make bench.

Both loops move the same vehicles along the same poses in the same net. They run one after the other in one process, so
that their ratio does not depend on the machine. The bare loop only calls moveToXY for each vehicle, steps, and reads
all states from one subscription.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from advdiff_sumo.core.frames import bumper_from_centre, sumo_from_yaw
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.core.seeds import SeedTree
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.maps.shipped_nets import find_net
from advdiff_sumo.planners.planner_registry import make_target
from advdiff_sumo.sim.episode import Episode
from advdiff_sumo.sim.episode_loop import Loop
from advdiff_sumo.sim.seed_scene import PlacedTraffic, SeedScene
from advdiff_sumo.sim.session import Session, SessionOptions
from advdiff_sumo.sim.sim_options import SimOptions
from advdiff_sumo.sim.start import prepare
from advdiff_sumo.sim.world import VARIABLES
from advdiff_sumo.traffic.policy_registry import make_policy

LENGTH_M, WIDTH_M, SPEED_MPS = 4.6, 1.9, 8.0
STEPS, REPEATS = 300, 5


def made_up_log(
    road: RoadMap, vehicles: int, duration_s: float, seed: int
) -> tuple[Tracks, list[tuple[str, ...]]]:
    """Return tracks and routes of vehicles that follow lanes at a constant speed, from −2 s to *duration_s*."""
    rng = np.random.default_rng(seed)
    edges = sorted(road.edge_graph().strongly_connected())
    dt, history = 0.5, 2.0
    steps = round((duration_s + history) / dt) + 1
    s = SPEED_MPS * dt * np.arange(steps)
    xy, yaw, routes = [], [], []
    while len(xy) < vehicles:
        route = road.random_route(edges[int(rng.integers(len(edges)))], s[-1] + 200.0, rng)
        lane = road.edges[route[0]].lane_ids[0]
        path = road.lane_path(route, lane, s[-1] + 100.0)[0]
        if path.line.length_m < s[-1] + 1.0:
            continue
        points, headings = path.line.at(s)
        xy.append(points)
        yaw.append(headings)
        routes.append(route)
    log = Tracks(
        ids=tuple(f"b{k}" for k in range(vehicles)),
        classes=np.full(vehicles, AgentClass.CAR, dtype=np.int64),
        size_m=np.tile([LENGTH_M, WIDTH_M], (vehicles, 1)),
        xy_m=np.stack(xy),
        yaw_rad=np.stack(yaw),
        speed_mps=np.full((vehicles, steps), SPEED_MPS),
        valid=np.ones((vehicles, steps), dtype=np.bool_),
        t0_s=-history,
        dt_s=dt,
    )
    return log, routes


def scene_of(road: RoadMap, log: Tracks, routes: list[tuple[str, ...]], duration_s: float) -> SeedScene:
    """Return a seed scene in which the first vehicle of *log* is the target and the others are replayed."""
    return SeedScene(
        name="bench",
        net=road.path,
        seed=1,
        history=log.window(0, 5),
        target=log.ids[0],
        routes=dict(zip(log.ids, routes, strict=True)),
        log=log,
        start=PlacedTraffic(np.ones(log.agents, dtype=np.bool_)),
        horizon_s=duration_s,
    )


def our_rate(road: RoadMap, scene: SeedScene) -> float:
    """Return steps per second of the episode loop, which plans, moves, steps, reads, checks contacts and records."""
    sim = SimOptions(stop_at_collision=False, record_radius_m=1e6)
    episode = Episode(
        number=0,
        scene=scene,
        road=road,
        target=make_target("IDM", {}),
        policy=make_policy("replay", {}),
        names=("IDM", "replay"),
        sim=sim,
        horizon_s=scene.horizon_s,
        seed=SeedTree(0),
    )
    with tempfile.TemporaryDirectory() as folder:
        preparation = prepare(scene, episode.target, sim, Path(folder))
        with Session(preparation.options) as session:
            loop = Loop(episode, session, preparation.type_of_class)
            loop.start()
            begun = time.perf_counter()
            loop.run(STEPS)
            return loop.steps / (time.perf_counter() - begun)


def bare_rate(road: RoadMap, scene: SeedScene, keep_route: int) -> float:
    """Return steps per second of a loop that only moves and reads the same vehicles.

    Args:
        road: the net.
        scene: its log is driven, except for the target.
        keep_route: that of moveToXY; 2: any edge, 3: an edge of the vehicle's own route.
    """
    log = scene.log
    options = SessionOptions(net=road.path, seed=1)
    names = [name for name in log.ids if name != scene.target]
    rows = np.array([log.index[name] for name in names])
    times = np.arange(STEPS + 2) * 0.1
    grid = log.times_s - log.t0_s
    x, y, turn = (
        np.stack([np.interp(times, grid, part[row]) for row in rows])
        for part in (log.xy_m[..., 0], log.xy_m[..., 1], np.unwrap(log.yaw_rad, axis=1))
    )
    front = bumper_from_centre(np.stack((x, y), -1), turn, np.full(x.shape, LENGTH_M))
    angle = sumo_from_yaw(turn)
    with Session(options) as session:
        vehicle = session.api.vehicle
        for name in names:
            session.api.route.add(name, list(scene.routes[name]))
            vehicle.add(name, name, depart="now", departPos="base")
        _move_all(vehicle, names, front[:, 0], angle[:, 0], 2)
        session.step()
        for name in names:
            vehicle.subscribe(name, VARIABLES)
            vehicle.setRoute(name, list(scene.routes[name]))
        begun = time.perf_counter()
        for k in range(1, STEPS + 1):
            _move_all(vehicle, names, front[:, k], angle[:, k], keep_route)
            session.step()
            vehicle.getAllSubscriptionResults()
        return STEPS / (time.perf_counter() - begun)


def _move_all(
    vehicle: object, names: list[str], front_m: np.ndarray, angle_deg: np.ndarray, keep_route: int
) -> None:
    for name, (x, y), turn in zip(names, front_m.tolist(), angle_deg.tolist(), strict=True):
        vehicle.moveToXY(name, "", -1, x, y, turn, keep_route)  # type: ignore[attr-defined] # libsumo has no types


def main() -> None:
    """Measure the loops and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--net", type=Path, default=find_net("downtown"))
    parser.add_argument("--moved", type=int, nargs="+", default=[5, 20, 80])
    arguments = parser.parse_args()
    road = RoadMap.read(arguments.net)
    table = Table(
        title=f"steps per second, {road.name}, {STEPS} steps, median of {REPEATS}", title_justify="left"
    )
    for name in (
        "moved",
        "our loop",
        "bare, any edge",
        "bare, own route",
        "ratio to any edge",
        "to own route",
    ):
        table.add_column(name, justify="right")
    for moved in arguments.moved:
        duration = (STEPS + 10) * 0.1
        log, routes = made_up_log(road, moved + 1, duration, seed=moved)
        scene = scene_of(road, replace(log), routes, duration)
        our_rates, any_edge_rates, own_route_rates = ([] for _ in range(3))
        for _ in range(REPEATS):  # in turn, so that a busy machine slows all three equally
            our_rates.append(our_rate(road, scene))
            any_edge_rates.append(bare_rate(road, scene, 2))
            own_route_rates.append(bare_rate(road, scene, 3))
        a, b, c = (statistics.median(rates) for rates in (our_rates, any_edge_rates, own_route_rates))
        table.add_row(str(moved), f"{a:,.0f}", f"{b:,.0f}", f"{c:,.0f}", f"{a / b:.2f}", f"{a / c:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
