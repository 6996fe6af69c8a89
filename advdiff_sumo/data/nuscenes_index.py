"""Reads and joins the nuScenes tables: scenes with their keyframes, ego poses and boxes."""

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
    """Return the class of a nuScenes *category*; None if it is no road user (cones, barriers, animals)."""
    for prefix, value in _CLASSES.items():
        if category == prefix or category.startswith(prefix + "."):
            return value
    return None


@dataclass(frozen=True)
class SceneEntry:
    """A row of ``scene.json`` with the map of its log.

    Attributes:
        token: key of the scene.
        name: name of the scene, such as "scene-0061".
        location: name of the map.
        samples: number of keyframes that the table states.
    """

    token: str
    name: str
    location: str
    samples: int


@dataclass(frozen=True)
class Keyframes:
    """The K keyframes of one scene.

    Attributes:
        tokens: tokens of the samples, ordered by time.
        slot: (K,) index of each keyframe on a regular 2 Hz clock; a missing keyframe leaves a slot empty.
    """

    tokens: tuple[str, ...]
    slot: IntArray


@dataclass(frozen=True)
class Boxes:
    """N annotated boxes of road users, sorted by scene; columns are (N,).

    Attributes:
        scene: index of the scene.
        slot: slot of the keyframe on the scene's clock.
        instance: index of the road user in :class:`Instances`.
        values: (N, 5) x, y, yaw, length, width.
    """

    scene: IntArray
    slot: IntArray
    instance: IntArray
    values: FloatArray

    def of(self, scene: int) -> Boxes:
        """Return the boxes of one scene."""
        start, stop = np.searchsorted(self.scene, [scene, scene + 1])
        rows = slice(start, stop)
        return Boxes(self.scene[rows], self.slot[rows], self.instance[rows], self.values[rows])


def read_scenes(folder: Path) -> list[SceneEntry]:
    """Return the scenes of a version *folder*, in the table's order."""
    locations = dict(parsed(folder / "log.json", lambda r: (r["token"], str(r["location"]))))

    def entry(record: dict[str, Any]) -> SceneEntry:
        log = record["log_token"]
        if log not in locations:
            raise ValueError(f"log_token {log} is not in log.json")
        return SceneEntry(record["token"], str(record["name"]), locations[log], int(record["nbr_samples"]))

    return list(parsed(folder / "scene.json", entry))


def read_keyframes(folder: Path, scenes: Sequence[SceneEntry]) -> list[Keyframes]:
    """Return the keyframes of each of *scenes*.

    Raises:
        LogError: the number of samples of a scene differs from what ``scene.json`` states.
    """
    path = folder / "sample.json"
    by_scene: dict[str, list[tuple[int, str]]] = {scene.token: [] for scene in scenes}
    for scene, time_us, token in parsed(path, lambda r: (r["scene_token"], int(r["timestamp"]), r["token"])):
        if scene not in by_scene:
            raise LogError(path, f"sample {token} names scene {scene}, which scene.json lacks", _REPAIR)
        by_scene[scene].append((time_us, token))
    keyframes = []
    for entry in scenes:
        timed_tokens = sorted(by_scene[entry.token])
        if len(timed_tokens) != entry.samples or not timed_tokens:
            problem = f"has {len(timed_tokens)} of the {entry.samples} samples of {entry.name}"
            raise LogError(path, problem, _REPAIR)
        keyframes.append(_keyframes(timed_tokens))
    return keyframes


def _keyframes(timed_tokens: Sequence[tuple[int, str]]) -> Keyframes:
    gaps_s = np.diff([time_us for time_us, _ in timed_tokens]) * 1e-6
    jumps = np.maximum(1, np.rint(gaps_s / KEYFRAME_S)).astype(np.int64)
    return Keyframes(tuple(token for _, token in timed_tokens), np.concatenate(([0], np.cumsum(jumps))))


def read_ego_poses(folder: Path, keyframes: Sequence[Keyframes]) -> list[FloatArray]:
    """Return for each scene (K, 3) x, y, yaw of the ego frame (middle of the rear axle) at its keyframes.

    A sample has the pose of its key-frame record that is nearest in time. That is the lidar sweep in which the boxes
    were annotated.
    """
    pose_tokens = _ego_pose_tokens(folder, {token for frames in keyframes for token in frames.tokens})
    used_tokens = set(pose_tokens.values())
    path = folder / "ego_pose.json"
    rows = parsed(path, lambda r: (r["token"], _pose(r) if r["token"] in used_tokens else None))
    poses = {token: pose for token, pose in rows if pose is not None}
    missing = sorted(used_tokens - poses.keys())
    if missing:
        raise LogError(path, f"has no record {missing[0]}, which sample_data.json names", _REPAIR)
    return [np.array([poses[pose_tokens[token]] for token in frames.tokens]) for frames in keyframes]


def _ego_pose_tokens(folder: Path, samples: set[str]) -> dict[str, str]:
    """Return sample token → token of its ego pose."""
    times = dict(parsed(folder / "sample.json", lambda r: (r["token"], int(r["timestamp"]))))
    path = folder / "sample_data.json"
    nearest: dict[str, tuple[int, str]] = {}

    def candidate_of(record: dict[str, Any]) -> tuple[str, tuple[int, str]] | None:
        sample = record["sample_token"]
        if not record["is_key_frame"] or sample not in samples:
            return None
        return sample, (abs(int(record["timestamp"]) - times[sample]), record["ego_pose_token"])

    for item in parsed(path, candidate_of):
        if item is not None:
            sample, candidate = item
            nearest[sample] = min(nearest.get(sample, candidate), candidate)
    missing = sorted(samples - nearest.keys())
    if missing:
        raise LogError(path, f"has no key frame of sample {missing[0]}", _REPAIR)
    return {sample: token for sample, (_, token) in nearest.items()}


@dataclass(frozen=True)
class Instances:
    """The road users of the dataset.

    Attributes:
        tokens: their tokens.
        classes: class of each.
        number: instance token → index in *tokens*; −1 for instances that are not road users.
    """

    tokens: tuple[str, ...]
    classes: tuple[AgentClass, ...]
    number: Mapping[str, int]


def read_instances(folder: Path) -> Instances:
    """Return the instances of a version *folder*."""
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
    """Return the boxes of all road users."""
    keyframe_of = {
        token: (scene, int(slot))
        for scene, frames in enumerate(keyframes)
        for token, slot in zip(frames.tokens, frames.slot, strict=True)
    }
    number = instances.number

    def box(record: dict[str, Any]) -> tuple[float, ...] | None:
        sample, instance = record["sample_token"], record["instance_token"]
        if sample not in keyframe_of:
            raise ValueError(f"sample_token {sample} is not in sample.json")
        if instance not in number:
            raise ValueError(f"instance_token {instance} is not in instance.json")
        if number[instance] < 0:
            return None
        width, length = float(record["size"][0]), float(record["size"][1])
        if not (0.0 < width < math.inf and 0.0 < length < math.inf):
            raise ValueError(f"size {record['size']} is no box")
        return (*keyframe_of[sample], number[instance], *_pose(record), length, width)

    values = array("d")  # 8 bytes a value; a list of tuples would need 40
    for row in parsed(folder / "sample_annotation.json", box):
        values.extend(row or ())
    table = np.array(values, dtype=np.float64).reshape(-1, 8)
    order = np.lexsort((table[:, 1], table[:, 2], table[:, 0]))
    table = table[order]
    keys = table[:, :3].astype(np.int64)
    return Boxes(keys[:, 0], keys[:, 1], keys[:, 2], table[:, 3:])


def _pose(record: dict[str, Any]) -> tuple[float, float, float]:
    """Return x, y, yaw from a record's translation and unit quaternion (w, x, y, z)."""
    x, y = float(record["translation"][0]), float(record["translation"][1])
    qw, qx, qy, qz = (float(part) for part in record["rotation"])
    if not all(map(math.isfinite, (x, y, qw, qx, qy, qz))) or abs(qw**2 + qx**2 + qy**2 + qz**2 - 1.0) > 1e-2:
        raise ValueError("translation or rotation is not a pose")
    return x, y, math.atan2(2.0 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
