"""Builds an OpenSCENARIO file: entities that appear, follow their trajectories and leave; needs the extra."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scenariogeneration import xosc

from advdiff_sumo.core.arrays import FloatArray, stretches
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.export.export_scene import ExportScene, plain_names, unwrapped

_MINOR = 2
PLAIN_NAME = r"[A-Za-z_][A-Za-z0-9_.-]*"
#: A constant date, so that the same episode gives the same file.
_DATE = datetime.datetime(1970, 1, 1)
_TIME_DIGITS, _POSITION_DIGITS, _YAW_DIGITS = 6, 4, 6
#: Usual wheelbase as a share of the length; the box's centre is assumed to be in the middle of it.
WHEELBASE_SHARE = 0.6
_HEIGHT_M = {AgentClass.CAR: 1.6, AgentClass.TRUCK: 3.2, AgentClass.BUS: 3.2}
_OTHER_HEIGHT_M = 1.7
# properties that the format requires and the episode does not have: usual values
_WHEEL_DIAMETER_M, _MAX_STEER_RAD = 0.6, 0.6
_MAX_SPEED_MPS, _MAX_ACCEL_MPS2, _MAX_BRAKE_MPS2 = 70.0, 10.0, 10.0
_PERSON_KG = 80


def scenario_of(scene: ExportScene, roads: str) -> xosc.Scenario:
    """Return the content of the file; *roads* is the name of the OpenDRIVE file beside it."""
    entities = xosc.Entities()
    names = plain_names(scene.tracks.ids, PLAIN_NAME)
    for row, name in enumerate(names):
        entities.add_scenario_object(name, entity_of(scene, row, name))
    return xosc.Scenario(
        scene.name,
        "advdiff-sumo",
        xosc.ParameterDeclarations(),
        entities,
        _storyboard(scene, names),
        xosc.RoadNetwork(roads),
        xosc.Catalog(),
        osc_minor_version=_MINOR,
        creation_date=_DATE,
    )


def _storyboard(scene: ExportScene, names: list[str]) -> xosc.StoryBoard:
    init = xosc.Init()
    end_s = scene.tracks.steps * scene.tracks.dt_s
    board = xosc.StoryBoard(init, _time_trigger("the end", end_s, start=False))
    story, act = xosc.Story("episode"), xosc.Act("traffic", _time_trigger("the start", 0.0))
    for row, name in enumerate(names):
        if scene.tracks.valid[row, 0]:
            init.add_init_action(name, xosc.TeleportAction(_pose(scene, row, 0, _reference(scene, row))))
            init.add_init_action(name, _speed(float(scene.tracks.speed_mps[row, 0])))
        group, manoeuvre = xosc.ManeuverGroup(f"group {name}"), xosc.Maneuver(f"manoeuvre {name}")
        group.add_actor(name)
        for event in _events(scene, row, name):
            manoeuvre.add_event(event)
        group.add_maneuver(manoeuvre)
        act.add_maneuver_group(group)
    story.add_act(act)
    board.add_story(story)
    return board


def _events(scene: ExportScene, row: int, name: str) -> Iterator[xosc.Event]:
    """Yield the events of each uninterrupted part of an agent's track.

    The agent appears, unless it is present from the start, follows its trajectory, and leaves.
    """
    tracks, reference = scene.tracks, _reference(scene, row)
    for start, stop in stretches(tracks.valid[row]):
        if start > 0:
            add = xosc.AddEntityAction(name, _pose(scene, row, start, reference))
            yield _event(f"{name} appears {start}", add, start * tracks.dt_s)
        if stop - start > 1:
            follow = _follow(scene, row, start, stop, reference, name)
            yield _event(f"{name} drives {start}", follow, start * tracks.dt_s)
        if stop < tracks.steps:
            yield _event(f"{name} leaves {stop}", xosc.DeleteEntityAction(name), (stop - 0.5) * tracks.dt_s)


def _event(name: str, action: object, time_s: float) -> xosc.Event:
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_trigger(_time_trigger(f"when {name}", time_s))
    event.add_action(f"action {name}", action)
    return event


def _follow(
    scene: ExportScene, row: int, start: int, stop: int, reference: Reference, name: str
) -> xosc.FollowTrajectoryAction:
    """Return the action of following the trajectory of agent *row* from step *start* to *stop*."""
    times = np.round(np.arange(start, stop) * scene.tracks.dt_s, _TIME_DIGITS)
    yaw = unwrapped(scene.tracks.yaw_rad[row, start:stop])
    xy = reference.from_centre(scene.tracks.xy_m[row, start:stop], yaw)
    poses = [_position(x, y, h) for (x, y), h in zip(xy, yaw, strict=True)]
    line = xosc.Trajectory(f"trajectory {name} {start}", closed=False)
    line.add_shape(xosc.Polyline(times.tolist(), poses))
    return xosc.FollowTrajectoryAction(
        line, xosc.FollowingMode.position, xosc.ReferenceContext.absolute, scale=1, offset=0
    )


def _reference(scene: ExportScene, row: int) -> Reference:
    return reference_of(int(scene.tracks.classes[row]), float(scene.tracks.size_m[row, 0]))


def _pose(scene: ExportScene, row: int, step: int, reference: Reference) -> xosc.WorldPosition:
    yaw = scene.tracks.yaw_rad[row, step]
    x, y = reference.from_centre(scene.tracks.xy_m[row, step], yaw)
    return _position(float(x), float(y), float(yaw))


def _position(x_m: float, y_m: float, yaw_rad: float) -> xosc.WorldPosition:
    x, y = (round(float(value), _POSITION_DIGITS) for value in (x_m, y_m))
    return xosc.WorldPosition(x=x, y=y, z=0, h=round(float(yaw_rad), _YAW_DIGITS))


def _speed(speed_mps: float) -> xosc.AbsoluteSpeedAction:
    immediate = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0)
    return xosc.AbsoluteSpeedAction(round(speed_mps, _POSITION_DIGITS), immediate)


def _time_trigger(name: str, time_s: float, start: bool = True) -> xosc.ValueTrigger:
    condition = xosc.SimulationTimeCondition(round(time_s, _TIME_DIGITS), xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger(
        name, 0, xosc.ConditionEdge.none, condition, triggeringpoint="start" if start else "stop"
    )


@dataclass(frozen=True)
class Reference:
    """The reference point of an entity, of which OpenSCENARIO states the position.

    Attributes:
        centre_ahead_m: distance of the box's centre ahead of it.
    """

    centre_ahead_m: float

    def from_centre(self, centre_xy_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
        """Return the reference points (…, 2) of boxes with these centres and headings."""
        return centre_xy_m - self.centre_ahead_m * unit(yaw_rad)


def reference_of(kind: int, length_m: float) -> Reference:
    """Return the reference point: the rear axle's centre, or the box's centre for pedestrians."""
    if kind == AgentClass.PEDESTRIAN:
        return Reference(0.0)
    return Reference(round(0.5 * WHEELBASE_SHARE * length_m, 4))


def entity_of(scene: ExportScene, row: int, name: str) -> xosc.Vehicle | xosc.Pedestrian:
    """Return the entity of an agent; its properties ``agent`` and ``role`` hold its name and mark the target."""
    kind = AgentClass(int(scene.tracks.classes[row]))
    length, width = (round(float(x), 4) for x in scene.tracks.size_m[row])
    reference, height = reference_of(kind, length), _HEIGHT_M.get(kind, _OTHER_HEIGHT_M)
    box = xosc.BoundingBox(width, length, height, reference.centre_ahead_m, 0, round(0.5 * height, 4))
    entity: xosc.Vehicle | xosc.Pedestrian
    if kind is AgentClass.PEDESTRIAN:
        entity = xosc.Pedestrian(name, _PERSON_KG, xosc.PedestrianCategory.pedestrian, box)
    else:
        wheelbase = 2.0 * reference.centre_ahead_m
        front = xosc.Axle(_MAX_STEER_RAD, _WHEEL_DIAMETER_M, width, wheelbase, 0.5 * _WHEEL_DIAMETER_M)
        rear = xosc.Axle(0, _WHEEL_DIAMETER_M, width, 0, 0.5 * _WHEEL_DIAMETER_M)
        limits = (_MAX_SPEED_MPS, _MAX_ACCEL_MPS2, _MAX_BRAKE_MPS2)
        entity = xosc.Vehicle(name, _category(kind), box, front, rear, *limits)
    entity.add_property("agent", scene.tracks.ids[row])
    entity.add_property("role", "target" if row == scene.target else "other")
    return entity


def _category(kind: AgentClass) -> xosc.VehicleCategory:
    return {
        AgentClass.TRUCK: xosc.VehicleCategory.truck,
        AgentClass.BUS: xosc.VehicleCategory.bus,
        AgentClass.MOTORCYCLE: xosc.VehicleCategory.motorbike,
        AgentClass.BICYCLE: xosc.VehicleCategory.bicycle,
    }.get(kind, xosc.VehicleCategory.car)
