"""Reads the boxes of nuScenes at its 2 Hz keyframes from the published tables, without the devkit.

Caesar et al. 2020 (arXiv:1903.11027). Boxes are annotated by their centres in the frame of the map expansion. The ego
pose is the middle of the rear axle. The recording cars are Renault Zoes, whose box centre is 1.385 m ahead of it
(docs/data.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from advdiff_sumo.core.arrays import FloatArray, IntArray
from advdiff_sumo.core.errors import LogError, UnknownNameError
from advdiff_sumo.core.frames import unit
from advdiff_sumo.core.scene import AgentClass, Tracks
from advdiff_sumo.data.log_reader import LogScene
from advdiff_sumo.data.motion import annotated_tracks, parked_agents, without_jitter
from advdiff_sumo.data.nuscenes_index import (
    KEYFRAME_S,
    Boxes,
    Instances,
    Keyframes,
    SceneEntry,
    read_boxes,
    read_ego_poses,
    read_instances,
    read_keyframes,
    read_scenes,
)

EGO_ID = "ego"
ZOE_LENGTH_M = 4.084
ZOE_WIDTH_M = 1.730
ZOE_REAR_OVERHANG_M = 0.657
ZOE_CENTRE_AHEAD_M = ZOE_LENGTH_M / 2.0 - ZOE_REAR_OVERHANG_M


class NuScenesReader:
    """Reads the scenes of a nuScenes dataset.

    Tables are read when they are first needed, and joined once, at the first scene.
    """

    def __init__(self, root: str | Path, version: str | None = None) -> None:
        """Create the reader of a dataset.

        Args:
            root: folder that contains ``v1.0-mini``, ``v1.0-trainval`` …, or such a folder itself.
            version: name of one of these folders; may be None if there is only one.
        """
        self.root = Path(root)
        self.version = version

    def names(self) -> list[str]:
        """Return the names of the scenes, in the table's order."""
        return [entry.name for entry in self._entries]

    def read(self, name: str) -> LogScene:
        """Return one scene; the ego is row 0, the other agents follow in the order of ``instance.json``.

        Raises:
            UnknownNameError: there is no such scene.
            LogError: a table is missing or damaged.
        """
        number = self._number(name)
        joined = self._joined
        tracks = _tracks(
            joined.keyframes[number],
            joined.ego[number],
            joined.boxes.of(number),
            joined.instances,
            self.folder,
        )
        parked = parked_agents(tracks.xy_m, tracks.valid, KEYFRAME_S)
        parked[0] = False
        tracks = without_jitter(tracks, parked, 0)
        return LogScene(name, self._entries[number].location, tracks, 0, parked, self.folder)

    def scenes(self) -> Iterator[LogScene]:
        """Yield all scenes."""
        return map(self.read, self.names())

    def instants(self, name: str) -> Mapping[str, int]:
        """Return sample token → instant of the tracks of scene *name*.

        Raises:
            UnknownNameError: there is no such scene.
        """
        frames = self._joined.keyframes[self._number(name)]
        return {token: int(slot) for token, slot in zip(frames.tokens, frames.slot, strict=True)}

    def _number(self, name: str) -> int:
        """Return the number of scene *name*; UnknownNameError if there is none."""
        names = self.names()
        if name not in names:
            raise UnknownNameError("scene", name, names)
        return names.index(name)

    @cached_property
    def folder(self) -> Path:
        """Folder of the tables.

        Raises:
            LogError: there is none, or there are several and no version was given.
        """
        if self.version is not None:
            folders = [self.root / self.version]
        elif (self.root / "scene.json").is_file():
            folders = [self.root]
        else:
            folders = sorted(p.parent for p in self.root.glob("v1.0-*/scene.json"))
        if not folders or not folders[0].is_dir():
            expected = self.version or "v1.0-* folder with a scene.json"
            raise LogError(self.root, f"holds no {expected}", "give the root of a nuScenes dataset")
        if len(folders) > 1:
            versions = ", ".join(p.name for p in folders)
            raise LogError(self.root, f"holds several versions ({versions})", "give one of these folders")
        return folders[0]

    @cached_property
    def _entries(self) -> list[SceneEntry]:
        return read_scenes(self.folder)

    @cached_property
    def _joined(self) -> _Joined:
        keyframes = read_keyframes(self.folder, self._entries)
        instances = read_instances(self.folder)
        return _Joined(
            keyframes=keyframes,
            ego=read_ego_poses(self.folder, keyframes),
            instances=instances,
            boxes=read_boxes(self.folder, keyframes, instances),
        )


@dataclass(frozen=True)
class _Joined:
    """The joined tables; lists have one item for each scene."""

    keyframes: list[Keyframes]
    ego: list[FloatArray]
    instances: Instances
    boxes: Boxes


def _tracks(frames: Keyframes, ego: FloatArray, boxes: Boxes, instances: Instances, folder: Path) -> Tracks:
    """Return the tracks of one scene; row 0 is the ego."""
    instance_rows, row = np.unique(boxes.instance, return_inverse=True)
    steps = int(frames.slot[-1]) + 1
    pose = np.full((len(instance_rows) + 1, steps, 3), np.nan)
    pose[0, frames.slot] = ego
    pose[0, frames.slot, :2] += ZOE_CENTRE_AHEAD_M * unit(ego[:, 2])
    _refuse_doubles(row, boxes, instances, folder)
    pose[1 + row, boxes.slot] = boxes.values[:, :3]
    ids = (EGO_ID, *(instances.tokens[i] for i in instance_rows))
    classes = [AgentClass.CAR, *(instances.classes[i] for i in instance_rows)]
    sizes = np.vstack(([ZOE_LENGTH_M, ZOE_WIDTH_M], _sizes(row, boxes, len(instance_rows))))
    return annotated_tracks(ids, classes, sizes, pose[..., :2], pose[..., 2], KEYFRAME_S)


def _sizes(row: IntArray, boxes: Boxes, agents: int) -> FloatArray:
    """Return the median length and width (A, 2) of each agent; *row* is the agent of each box."""
    if agents == 0:
        return np.zeros((0, 2))
    return np.array([np.median(boxes.values[row == i, 3:], axis=0) for i in range(agents)])


def _refuse_doubles(row: IntArray, boxes: Boxes, instances: Instances, folder: Path) -> None:
    """Raise if an agent has two boxes at one keyframe."""
    key = np.column_stack((row, boxes.slot))
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    for box in first[count > 1][:1]:
        token = instances.tokens[boxes.instance[box]]
        problem = f"instance {token} has two boxes at keyframe {boxes.slot[box]}"
        raise LogError(folder / "sample_annotation.json", problem, "remove one of them")
