"""Serves a Python planner to advdiff-sumo from an environment that needs only grpcio, protobuf and NumPy.

::

    from advdiff_sumo.planner_kit import serve
    serve(MyPlanner)

This package imports only a few modules of ``core`` besides its own (``planners.remote.write_kit`` lists them).
"""

from advdiff_sumo.core.plan import Controls, Trajectory
from advdiff_sumo.core.scene import Scene, Tracks
from advdiff_sumo.planner_kit.kit_road import KitRoad
from advdiff_sumo.planner_kit.planner_server import serve

__all__ = ["Controls", "KitRoad", "Scene", "Tracks", "Trajectory", "serve"]
