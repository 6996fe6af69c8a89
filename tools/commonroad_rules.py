"""Print the answers of CommonRoad's rule monitor at every instant as JSON; started by check_monitor.py.

It runs in a separate environment with commonroad-stl-monitor 2025.1.1, commonroad-io 2024.3 and
antlr4-python3-runtime 4.9.3, and imports nothing from this project.
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


def unsmoothed(path, params, preprocess_path=True):  # noqa: ARG001 - same parameters as the original
    """Return the curvilinear frame of a lane without smoothing its line, which would take minutes for each scene."""
    return _CoordinateSystem(path, params, preprocess_path=False)


def world_of(path):
    """Return the monitor's world of the scenario *path*, with the response time and deceleration of our safe gap."""
    scenario, _ = CommonRoadFileReader(path).open()
    config = WorldConfig()
    config.road_network_param.polyline_resampling_step = 2.0
    world = World.create_from_scenario(scenario, config)
    for vehicle in world.vehicles:
        vehicle.vehicle_param.t_react, vehicle.vehicle_param.a_min = RESPONSE_S, BRAKE_MPS2
    return world


def holds(predicate, world, step, ids):
    """Return whether *predicate* is true; None if a position has no coordinates in the lane's frame."""
    try:
        return bool(predicate.evaluate_robustness(world, step, ids) > 0.0)
    except (ValueError, AttributeError, KeyError):
        return None


def unsafe(world, step, own):
    """Return the vehicles ahead in the lane to which the distance is unsafe (R_G1 without its cut-in exception)."""
    in_front, same_lane, safe_distance = PredInFrontOf(), PredInSameLane(), PredSafeDistPrec()
    return [
        other.id
        for other in world.vehicles
        if other.id != own
        and other.is_valid(step)
        and holds(in_front, world, step, (own, other.id))
        and holds(same_lane, world, step, (own, other.id))
        and holds(safe_distance, world, step, (own, other.id)) is False
    ]


def judged(path, own):
    """Return the instants of the target, its unsafe distances by instant, and when each vehicle is too fast."""
    world = world_of(path)
    vehicle = world.vehicle_by_id(own)
    steps = range(vehicle.start_time, vehicle.end_time + 1)
    limit = PredLaneSpeedLimit()
    too_fast = {
        other.id: [
            step
            for step in range(other.start_time, other.end_time + 1)
            if holds(limit, world, step, (other.id,)) is False
        ]
        for other in world.vehicles
    }
    return {
        "path": path,
        "steps": list(steps),
        "unsafe": {step: others for step in steps if (others := unsafe(world, step, own))},
        "too_fast": too_fast,
    }


def main():
    """Print a line with a JSON object for each pair of file and target's number; "failed" has the monitor's error."""
    network.CurvilinearCoordinateSystem = unsmoothed
    for path, own in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        with contextlib.redirect_stdout(io.StringIO()):
            try:
                answer = judged(path, int(own))
            except Exception as error:  # noqa: BLE001 - any error of the monitor is printed as its answer
                answer = {"path": path, "failed": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
