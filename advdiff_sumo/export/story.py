"""The storyboard of an OpenSCENARIO file: who appears, follows which trajectory, and leaves; needs the extra."""

from __future__ import annotations

import datetime
from collections.abc import Iterator

import numpy as np
from scenariogeneration import xosc

from advdiff_sumo.export.entities import Reference, entity_of, reference_of
from advdiff_sumo.export.export_scene import ExportScene, plain_names, stretches, unwrapped

_MINOR = 2
PLAIN_NAME = r"[A-Za-z_][A-Za-z0-9_.-]*"
#: No date of today: the same episode gives the same file.
_DATE = datetime.datetime(1970, 1, 1)
_TIME_DIGITS, _POSITION_DIGITS, _YAW_DIGITS = 6, 4, 6


def scenario_of(scene: ExportScene, roads: str) -> xosc.Scenario:
    """Return the whole file; *roads* names the OpenDRIVE file beside it."""
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
    board = xosc.StoryBoard(init, _at("the end", end_s, start=False))
    story, act = xosc.Story("episode"), xosc.Act("traffic", _at("the start", 0.0))
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
    """Yield for each stretch of an agent: it appears (unless there from the start), drives, leaves."""
    tracks, reference = scene.tracks, _reference(scene, row)
    for start, stop in stretches(tracks.valid[row]):
        if start > 0:
            appears = xosc.AddEntityAction(name, _pose(scene, row, start, reference))
            yield _event(f"{name} appears {start}", appears, start * tracks.dt_s)
        if stop - start > 1:
            drives = _follow(scene, row, start, stop, reference, name)
            yield _event(f"{name} drives {start}", drives, start * tracks.dt_s)
        if stop < tracks.steps:
            yield _event(f"{name} leaves {stop}", xosc.DeleteEntityAction(name), (stop - 0.5) * tracks.dt_s)


def _event(name: str, action: object, time_s: float) -> xosc.Event:
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_trigger(_at(f"when {name}", time_s))
    event.add_action(f"action {name}", action)
    return event


def _follow(
    scene: ExportScene, row: int, start: int, stop: int, reference: Reference, name: str
) -> xosc.FollowTrajectoryAction:
    times = np.round(np.arange(start, stop) * scene.tracks.dt_s, _TIME_DIGITS)
    yaw = unwrapped(scene.tracks.yaw_rad[row, start:stop])
    xy = reference.from_centre(scene.tracks.xy_m[row, start:stop], yaw)
    poses = [_world(x, y, h) for (x, y), h in zip(xy, yaw, strict=True)]
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
    return _world(float(x), float(y), float(yaw))


def _world(x_m: float, y_m: float, yaw_rad: float) -> xosc.WorldPosition:
    x, y = (round(float(value), _POSITION_DIGITS) for value in (x_m, y_m))
    return xosc.WorldPosition(x=x, y=y, z=0, h=round(float(yaw_rad), _YAW_DIGITS))


def _speed(speed_mps: float) -> xosc.AbsoluteSpeedAction:
    at_once = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0)
    return xosc.AbsoluteSpeedAction(round(speed_mps, _POSITION_DIGITS), at_once)


def _at(name: str, time_s: float, start: bool = True) -> xosc.ValueTrigger:
    condition = xosc.SimulationTimeCondition(round(time_s, _TIME_DIGITS), xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger(
        name, 0, xosc.ConditionEdge.none, condition, triggeringpoint="start" if start else "stop"
    )
