"""Print what CommonRoad's rule monitor says of one road user at every instant, as JSON; started by check_monitor.py.

Runs in an environment of its own with commonroad-stl-monitor 2025.1.1, commonroad-io 2024.3 and
antlr4-python3-runtime 4.9.3, and imports nothing of this project.
"""

import contextlib
import io
import json
import sys
import warnings

warnings.filterwarnings("ignore")

import crmonitor.common.road_network as network  # noqa: E402 - its imports warn
from commonroad.common.file_reader import CommonRoadFileReader  # noqa: E402
from crmonitor.common.world import World, WorldConfig  # noqa: E402
from crmonitor.predicates.position import PredInFrontOf, PredInSameLane, PredSafeDistPrec  # noqa: E402
from crmonitor.predicates.velocity import PredLaneSpeedLimit  # noqa: E402

RESPONSE_S, BRAKE_MPS2 = 0.75, -6.0
_CoordinateSystem = network.CurvilinearCoordinateSystem


def plain(path, params, preprocess_path=True):  # noqa: ARG001 - the original has it
    """Return the lane's coordinates without smoothing its line, which takes minutes a scene."""
    return _CoordinateSystem(path, params, preprocess_path=False)


def world_of(path):
    """Return the scenario as the monitor sees it, its drivers with the response and brakes of our safe gap."""
    scenario, _ = CommonRoadFileReader(path).open()
    config = WorldConfig()
    config.road_network_param.polyline_resampling_step = 2.0
    world = World.create_from_scenario(scenario, config)
    for vehicle in world.vehicles:
        vehicle.vehicle_param.t_react, vehicle.vehicle_param.a_min = RESPONSE_S, BRAKE_MPS2
    return world


def holds(predicate, world, step, ids):
    """Return whether *predicate* is true; None where a place cannot be put into the lane's frame."""
    try:
        return bool(predicate.evaluate_robustness(world, step, ids) > 0.0)
    except (ValueError, AttributeError, KeyError):
        return None


def unsafe(world, step, own):
    """Return to whom ahead in the lane the safe distance is not kept (R_G1 without its cut-ins)."""
    ahead, same, safe = PredInFrontOf(), PredInSameLane(), PredSafeDistPrec()
    return [
        other.id
        for other in world.vehicles
        if other.id != own
        and other.is_valid(step)
        and holds(ahead, world, step, (own, other.id))
        and holds(same, world, step, (own, other.id))
        and holds(safe, world, step, (own, other.id)) is False
    ]


def judged(path, own):
    """Return the instants of the target, those at which it is too near, and those at which anybody is too fast."""
    world = world_of(path)
    vehicle = world.vehicle_by_id(own)
    steps = range(vehicle.start_time, vehicle.end_time + 1)
    limit = PredLaneSpeedLimit()
    too_fast = {
        one.id: [
            step
            for step in range(one.start_time, one.end_time + 1)
            if holds(limit, world, step, (one.id,)) is False
        ]
        for one in world.vehicles
    }
    return {
        "path": path,
        "steps": list(steps),
        "unsafe": {step: others for step in steps if (others := unsafe(world, step, own))},
        "too_fast": too_fast,
    }


def main():
    """Print one JSON object a line for each pair of file and target's number; {} where the monitor fails."""
    network.CurvilinearCoordinateSystem = plain
    for path, own in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        with contextlib.redirect_stdout(io.StringIO()):
            try:
                answer = judged(path, int(own))
            except Exception as error:  # noqa: BLE001 - whatever it raises is its answer
                answer = {"path": path, "failed": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
