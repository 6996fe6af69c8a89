"""Mapping between SUMO's vehicle classes and those of this package."""

from __future__ import annotations

from advdiff_sumo.core.scene import AgentClass

CLASS_OF_VCLASS = {
    "truck": AgentClass.TRUCK,
    "trailer": AgentClass.TRUCK,
    "delivery": AgentClass.TRUCK,
    "emergency": AgentClass.TRUCK,
    "bus": AgentClass.BUS,
    "coach": AgentClass.BUS,
    "tram": AgentClass.BUS,
    "motorcycle": AgentClass.MOTORCYCLE,
    "moped": AgentClass.MOTORCYCLE,
    "bicycle": AgentClass.BICYCLE,
    "pedestrian": AgentClass.PEDESTRIAN,
}
"""Class of road user for each of SUMO's vehicle classes; all others are cars."""
VCLASS_OF_CLASS = {
    AgentClass.CAR: "passenger",
    AgentClass.TRUCK: "truck",
    AgentClass.BUS: "bus",
    AgentClass.MOTORCYCLE: "motorcycle",
    AgentClass.BICYCLE: "bicycle",
    AgentClass.PEDESTRIAN: "pedestrian",
}
