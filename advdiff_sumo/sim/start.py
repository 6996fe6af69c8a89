"""Write the files and options with which SUMO starts at a seed scene's first instant."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, fromstring, tostring

from advdiff_sumo.core.errors import ConfigError, SimulationError
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.core.sumo_classes import VCLASS_OF_CLASS
from advdiff_sumo.planners.planner_protocol import SumoDriver, Target
from advdiff_sumo.sim.seed_scene import SavedTraffic, SeedScene
from advdiff_sumo.sim.session import SessionOptions
from advdiff_sumo.sim.sim_options import SimOptions

TARGET_TYPE = "advdiff.target"
_CLASS_TYPE = "advdiff.{}"  # vType of inserted vehicles, by the name of their class
_SUBLANE_MODEL, _LANE_MODEL = "SL2015", "LC2013"


@dataclass(frozen=True)
class Preparation:
    """What SUMO needs to start in a scene.

    Attributes:
        options: for the session.
        type_of_class: vType for inserted vehicles of each class.
    """

    options: SessionOptions
    type_of_class: Mapping[AgentClass, str]


def prepare(
    scene: SeedScene, target: Target, sim: SimOptions, folder: Path, gui: bool = False
) -> Preparation:
    """Write the files with which SUMO starts in *scene*, with *target* as driver of the tested vehicle.

    Args:
        scene: the seed scene.
        target: what drives its target vehicle, as :func:`~advdiff_sumo.sim.sumo_target.as_driven` returns it.
        sim: steps and sublanes.
        folder: for the files; must exist as long as the session.
        gui: open sumo-gui.

    Raises:
        ConfigError: the target's lane-change model does not support the sublane setting.
    """
    types = folder / "types.add.xml"
    _write_types(scene, target, sim, types)
    routes: tuple[Path, ...] = ()
    additional: tuple[Path, ...] = ()
    state, begin = None, -sim.history_s
    if isinstance(scene.start, SavedTraffic):
        routes = _write_all(scene.start.routes, folder, "demand{}.rou.xml")
        additional = _write_all(scene.start.additional, folder, "extra{}.add.xml")
        state, begin = folder / "state.xml", scene.start.time_s
        state.write_bytes(_with_target_type(scene.start.state_xml, scene.target, target))
    options = SessionOptions(
        net=scene.net,
        seed=scene.seed,
        step_s=sim.step_s,
        lateral_resolution_m=sim.lateral_resolution_m,
        routes=routes,
        additional=(types, *additional),
        load_state=state,
        begin_s=max(begin, 0.0),
        gui=gui,
    )
    return Preparation(options, {c: _CLASS_TYPE.format(c.name.lower()) for c in AgentClass})


def _write_all(contents: tuple[bytes, ...], folder: Path, pattern: str) -> tuple[Path, ...]:
    paths = tuple(folder / pattern.format(k) for k in range(len(contents)))
    for path, content in zip(paths, contents, strict=True):
        path.write_bytes(content)
    return paths


def _write_types(scene: SeedScene, target: Target, sim: SimOptions, path: Path) -> None:
    """Write the vTypes of the target and of inserted vehicles of each class."""
    root = Element("additional")
    row = scene.history.index[scene.target]
    length, width = scene.history.size_m[row].tolist()
    attributes = {
        "id": TARGET_TYPE,
        "vClass": "passenger",
        "length": f"{length:.3f}",
        "width": f"{width:.3f}",
    }
    SubElement(root, "vType", attributes | _driver(target, sim))
    for agent_class in AgentClass:
        name = _CLASS_TYPE.format(agent_class.name.lower())
        vclass = VCLASS_OF_CLASS[agent_class]
        SubElement(root, "vType", {"id": name, "vClass": vclass, "carFollowModel": "IDM", "speedDev": "0"})
    ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _driver(target: Target, sim: SimOptions) -> dict[str, str]:
    """Return the vType attributes of the target's driver model."""
    if not isinstance(target, SumoDriver):
        return {"carFollowModel": "IDM", "speedDev": "0"}
    own = {
        key: f"{value:g}" if isinstance(value, float) else str(value) for key, value in target.params.items()
    }
    model = lane_change_model(target, sim)
    return {"speedDev": "0", "carFollowModel": target.car_following, "laneChangeModel": model, **own}


def lane_change_model(target: SumoDriver, sim: SimOptions) -> str:
    """Return the lane-change model for *target*; without sublanes, LC2013 replaces the default SL2015.

    Raises:
        ConfigError: the model does not support the sublane setting.
    """
    has_sublanes = sim.lateral_resolution_m > 0.0
    if has_sublanes and target.lane_change != _SUBLANE_MODEL:
        raise ConfigError(
            f"lane-change model {target.lane_change} does not drive on sublanes; "
            "set sim.lateral_resolution_m = 0 or use SL2015"
        )
    return target.lane_change if has_sublanes or target.lane_change != _SUBLANE_MODEL else _LANE_MODEL


def _with_target_type(state_xml: bytes, target_id: str, target: Target) -> bytes:
    """Return a saved state in which vehicle *target_id* has the target's type and desired speed factor."""
    root = fromstring(_escaped(state_xml))  # noqa: S314 - SUMO wrote it a moment ago
    vehicle = next((v for v in root.iter("vehicle") if v.get("id") == target_id), None)
    if vehicle is None:
        raise SimulationError(f"the saved traffic holds no vehicle '{target_id}'")
    vehicle.set("type", TARGET_TYPE)
    speed_factor = target.params.get("speedFactor", 1.0) if isinstance(target, SumoDriver) else 1.0
    vehicle.set("speedFactor", f"{float(speed_factor):.4f}")
    for saved in root.iter("vehicle"):
        _drop_speed_advices(saved)
    return bytes(tostring(root, encoding="utf-8", xml_declaration=True))


def _escaped(state_xml: bytes) -> bytes:
    """Return a saved state as valid XML: SUMO 1.28 does not escape "<" and "&" in ids, and cannot read them back."""
    text = re.sub(rb"&(?!(?:amp|lt|gt|quot|apos|#\d+|#x[0-9a-fA-F]+);)", b"&amp;", state_xml)
    return re.sub(rb'"[^"]*"', lambda value: value.group().replace(b"<", b"&lt;"), text)


def _drop_speed_advices(vehicle: Element) -> None:
    """Keep only the first number of a saved lane-change state, its flags.

    The other numbers are speed advices of the step before. SUMO 1.28 writes their owner in a form that it cannot read
    back, so whether it follows them would depend on uninitialised memory.
    """
    state = vehicle.get("lcStateBase", "").split()
    if len(state) > 1:
        vehicle.set("lcStateBase", state[0])
