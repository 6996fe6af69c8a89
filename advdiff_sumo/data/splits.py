"""Lists the published splits of nuScenes by scene name, and reads the windows of its prediction challenge.

Caesar et al. 2020 (arXiv:1903.11027). The lists are part of the data set's definition. The test split is left out, as
its scenes have no annotations.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

from advdiff_sumo.core.errors import LogError, UnknownNameError

SPLITS = ("train", "val", "train_val", "mini_train", "mini_val")
"""``train_val`` is the part of ``train`` that the prediction challenge holds out; the challenge trains on the rest."""
PREDICTION_FILE = Path("maps", "prediction", "prediction_scenes.json")
# numbers of the scenes of each split; _VAL in ranges (first, last)
_VAL = (
    *((3, 3), (12, 18), (35, 36), (38, 39), (92, 110), (221, 221), (268, 278), (329, 332), (344, 346)),
    *((519, 524), (552, 565), (625, 627), (629, 630), (632, 638), (770, 771), (775, 775), (777, 778)),
    *((780, 784), (794, 800), (802, 802), (904, 917), (919, 931), (962, 963), (966, 969), (971, 972)),
    (1059, 1073),
)
_MINI_TRAIN = (61, 553, 655, 757, 796, 1077, 1094, 1100)
_MINI_VAL = (103, 916)
_LAST_HELD_OUT = 300
_REPAIR = "unpack the map expansion again"


def in_split(scene: str, split: str, prediction: bool = False) -> bool:
    """Return whether *scene*, such as "scene-0061", belongs to the published *split*.

    Args:
        scene: name of a scene of v1.0-trainval or v1.0-mini.
        split: one of :data:`SPLITS`.
        prediction: whether ``train`` excludes ``train_val``, as in the prediction challenge.

    Raises:
        UnknownNameError: there is no such split.
    """
    if split not in SPLITS:
        raise UnknownNameError("split", split, SPLITS)
    matched = re.fullmatch(r"scene-(\d{4})", scene)
    if matched is None:
        return False
    number = int(matched.group(1))
    if split.startswith("mini"):
        return number in (_MINI_TRAIN if split == "mini_train" else _MINI_VAL)
    is_val = any(first <= number <= last for first, last in _VAL)
    if split == "val":
        return is_val
    is_held_out = number <= _LAST_HELD_OUT
    return not is_val and (is_held_out if split == "train_val" else not (prediction and is_held_out))


def prediction_windows(root: Path) -> Mapping[str, tuple[tuple[str, str], ...]]:
    """Return the windows of the prediction challenge: scene name → (instance token, sample token) of each.

    The past of a window ends and its future begins at the sample.

    Args:
        root: root of the data set with the map expansion, which contains the file.

    Raises:
        LogError: the file is missing or damaged.
    """
    path = root / PREDICTION_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise LogError(path, "no such file", _REPAIR) from None
    except (OSError, ValueError) as error:
        raise LogError(path, f"is not readable as JSON ({error})", _REPAIR) from None
    if not isinstance(content, dict):
        raise LogError(path, "is no table of scenes", _REPAIR)
    windows = {}
    for scene, names in content.items():
        pairs = [str(name).split("_") for name in names] if isinstance(names, list) else [[]]
        if any(len(pair) != 2 for pair in pairs):
            raise LogError(path, f"{scene} holds something other than instance_sample tokens", _REPAIR)
        windows[str(scene)] = tuple((pair[0], pair[1]) for pair in pairs)
    return windows
