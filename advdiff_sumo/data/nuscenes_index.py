"""The nuScenes tables joined once: scenes with their keyframes, ego poses and boxes as columns."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.errors import LogError
from advdiff_sumo.core.scene import AgentClass
from advdiff_sumo.data.tables import parsed

KEYFRAME_S = 0.5
_REPAIR = "the tables are not of one release: copy or download them again"

_CLASSES = {
    "vehicle.car": AgentClass.CAR,
    "vehicle.emergency.police": AgentClass.CAR,
    "vehicle.truck": AgentClass.TRUCK,
    "vehicle.construction": AgentClass.TRUCK,
    "vehicle.trailer": AgentClass.TRUCK,
    "vehicle.emergency.ambulance": AgentClass.TRUCK,
    "vehicle.bus": AgentClass.BUS,
    "vehicle.motorcycle": AgentClass.MOTORCYCLE,
    "vehicle.bicycle": AgentClass.BICYCLE,
    "human.pedestrian": AgentClass.PEDESTRIAN,
}


def agent_class(category: str) -> AgentClass | None:
    """Return the class of a nuScenes *category*; None for what is no road user (cones, barriers, animals)."""
    for prefix, value in _CLASSES.items():
        if category == prefix or category.startswith(prefix + "."):
            return value
    return None


@dataclass(frozen=True)
class SceneEntry:
    """One row of ``scene.json`` with its log's map.

    Attributes:
        token: key of the scene.
        name: such as "scene-0061".
        location: name of the map.
        samples: number of keyframes that the table promises.
    """

    token: str
    name: str
    location: str
    samples: int


@dataclass(frozen=True)
class Keyframes:
    """The K keyframes of one scene.

    Attributes:
        tokens: of the samples, in order of time.
        slot: (K,) index of each on the even 2 Hz clock; a dropped keyframe leaves a slot empty.
    """

    tokens: tuple[str, ...]
    slot: IntArray


@dataclass(frozen=True)
class Boxes:
    """N annotated boxes of road users, sorted by scene; columns are (N,).

    Attributes:
        scene: token's number of the scene.
        slot: keyframe on the scene's clock.
        instance: number of the instance.
        values: (N, 5) x, y, yaw, length, width.
    """

    scene: IntArray
    slot: IntArray
    instance: IntArray
    values: FloatArray

    def of(self, scene: int) -> Boxes:
        """Return the boxes of one scene."""
        lo, hi = np.searchsorted(self.scene, [scene, scene + 1])
        return Boxes(self.scene[lo:hi], self.slot[lo:hi], self.instance[lo:hi], self.values[lo:hi])


def read_scenes(folder: Path) -> list[SceneEntry]:
    """Return the scenes of a version *folder* in the table's order."""
    located = dict(parsed(folder / "log.json", lambda r: (r["token"], str(r["location"]))))

    def entry(record: dict[str, Any]) -> SceneEntry:
        log = record["log_token"]
        if log not in located:
            raise ValueError(f"log_token {log} is not in log.json")
        return SceneEntry(record["token"], str(record["name"]), located[log], int(record["nbr_samples"]))

    return list(parsed(folder / "scene.json", entry))


def read_keyframes(folder: Path, scenes: Sequence[SceneEntry]) -> list[Keyframes]:
    """Return the keyframes of each of *scenes*.

    Raises:
        LogError: a scene has another number of samples than it promises.
    """
    path = folder / "sample.json"
    by_scene: dict[str, list[tuple[int, str]]] = {scene.token: [] for scene in scenes}
    for scene, time_us, token in parsed(path, lambda r: (r["scene_token"], int(r["timestamp"]), r["token"])):
        if scene not in by_scene:
            raise LogError(path, f"sample {token} names scene {scene}, which scene.json lacks", _REPAIR)
        by_scene[scene].append((time_us, token))
    result = []
    for entry in scenes:
        keyframes = sorted(by_scene[entry.token])
        if len(keyframes) != entry.samples or not keyframes:
            problem = f"has {len(keyframes)} of the {entry.samples} samples of {entry.name}"
            raise LogError(path, problem, _REPAIR)
        result.append(_keyframes(keyframes))
    return result


def _keyframes(timed_tokens: Sequence[tuple[int, str]]) -> Keyframes:
    gaps_s = np.diff([time_us for time_us, _ in timed_tokens]) * 1e-6
    jumps = np.maximum(1, np.rint(gaps_s / KEYFRAME_S)).astype(np.int64)
    return Keyframes(tuple(token for _, token in timed_tokens), np.concatenate(([0], np.cumsum(jumps))))


def read_ego_poses(folder: Path, keyframes: Sequence[Keyframes]) -> list[FloatArray]:
    """Return for each scene (K, 3) x, y, yaw of the ego frame (mid rear axle) at its keyframes.

    A keyframe takes the pose of the key-frame record that is nearest in time to the sample: the lidar
    sweep that the boxes were annotated in.
    """
    wanted = _ego_tokens(folder, {token for frames in keyframes for token in frames.tokens})
    users = set(wanted.values())
    path = folder / "ego_pose.json"
    rows = parsed(path, lambda r: (r["token"], _pose(r) if r["token"] in users else None))
    poses = {token: pose for token, pose in rows if pose is not None}
    missing = sorted(users - poses.keys())
    if missing:
        raise LogError(path, f"has no record {missing[0]}, which sample_data.json names", _REPAIR)
    return [np.array([poses[wanted[token]] for token in frames.tokens]) for frames in keyframes]


def _ego_tokens(folder: Path, samples: set[str]) -> dict[str, str]:
    times = dict(parsed(folder / "sample.json", lambda r: (r["token"], int(r["timestamp"]))))
    path = folder / "sample_data.json"
    best: dict[str, tuple[int, str]] = {}

    def key(record: dict[str, Any]) -> tuple[str, tuple[int, str]] | None:
        sample = record["sample_token"]
        if not record["is_key_frame"] or sample not in samples:
            return None
        return sample, (abs(int(record["timestamp"]) - times[sample]), record["ego_pose_token"])

    for item in parsed(path, key):
        if item is not None:
            sample, candidate = item
            best[sample] = min(best.get(sample, candidate), candidate)
    missing = sorted(samples - best.keys())
    if missing:
        raise LogError(path, f"has no key frame of sample {missing[0]}", _REPAIR)
    return {sample: token for sample, (_, token) in best.items()}


@dataclass(frozen=True)
class Instances:
    """Road users of the dataset.

    Attributes:
        tokens: their names.
        classes: class of each.
        number: token → index, of every instance; −1 for what is no road user.
    """

    tokens: tuple[str, ...]
    classes: tuple[AgentClass, ...]
    number: Mapping[str, int]


def read_instances(folder: Path) -> Instances:
    """Return the annotated things of a version *folder*."""
    categories = dict(parsed(folder / "category.json", lambda r: (r["token"], agent_class(str(r["name"])))))

    def entry(record: dict[str, Any]) -> tuple[str, AgentClass | None]:
        category = record["category_token"]
        if category not in categories:
            raise ValueError(f"category_token {category} is not in category.json")
        return record["token"], categories[category]

    rows = list(parsed(folder / "instance.json", entry))
    users = [(token, kind) for token, kind in rows if kind is not None]
    number = {token: -1 for token, _ in rows} | {token: i for i, (token, _) in enumerate(users)}
    return Instances(tuple(t for t, _ in users), tuple(k for _, k in users), number)


def read_boxes(folder: Path, keyframes: Sequence[Keyframes], instances: Instances) -> Boxes:
    """Return every road user's boxes."""
    place = {
        token: (scene, int(slot))
        for scene, frames in enumerate(keyframes)
        for token, slot in zip(frames.tokens, frames.slot, strict=True)
    }
    number = instances.number

    def box(record: dict[str, Any]) -> tuple[float, ...] | None:
        sample, instance = record["sample_token"], record["instance_token"]
        if sample not in place:
            raise ValueError(f"sample_token {sample} is not in sample.json")
        if instance not in number:
            raise ValueError(f"instance_token {instance} is not in instance.json")
        if number[instance] < 0:
            return None
        width, length = float(record["size"][0]), float(record["size"][1])
        if not (0.0 < width < math.inf and 0.0 < length < math.inf):
            raise ValueError(f"size {record['size']} is no box")
        return (*place[sample], number[instance], *_pose(record), length, width)

    numbers = array("d")  # eight bytes each, where a list of tuples would take forty
    for row in parsed(folder / "sample_annotation.json", box):
        numbers.extend(row or ())
    table = np.array(numbers, dtype=np.float64).reshape(-1, 8)
    order = np.lexsort((table[:, 1], table[:, 2], table[:, 0]))
    table = table[order]
    keys = table[:, :3].astype(np.int64)
    return Boxes(keys[:, 0], keys[:, 1], keys[:, 2], table[:, 3:])


def _pose(record: dict[str, Any]) -> tuple[float, float, float]:
    """Return x, y, yaw of a record's translation and unit quaternion (w, x, y, z)."""
    x, y = float(record["translation"][0]), float(record["translation"][1])
    qw, qx, qy, qz = (float(part) for part in record["rotation"])
    if not all(map(math.isfinite, (x, y, qw, qx, qy, qz))) or abs(qw**2 + qx**2 + qy**2 + qz**2 - 1.0) > 1e-2:
        raise ValueError("translation or rotation is not a pose")
    return x, y, math.atan2(2.0 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
