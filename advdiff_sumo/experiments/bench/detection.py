"""Which defects a background detects: valid failures beside the sound planner's on the same seed scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeAlias

from advdiff_sumo.metrics.severity import is_valid_failure
from advdiff_sumo.metrics.statistics import holm, mcnemar_more

LEVEL = 0.05
"""A defect is detected where its adjusted p is below it."""


@dataclass(frozen=True)
class EpisodeOutcome:
    """What an episode came to.

    Attributes:
        failed: the target failed validly.
        cpu_s: processor time that it took.
    """

    failed: bool
    cpu_s: float = 0.0

    @staticmethod
    def of(row: Mapping[str, Any], cpu_s: float | None) -> EpisodeOutcome:
        """Return that of a row of ``episodes``; what cannot be judged is no valid failure."""
        return EpisodeOutcome(is_valid_failure(row), cpu_s or 0.0)


Tried: TypeAlias = Mapping[str, EpisodeOutcome]
"""Seed scene → what came of it, in the order in which the scenes are tried."""


@dataclass(frozen=True)
class Detection:
    """One defect before one background.

    Attributes:
        defect: its name with its severity.
        scenes: how many both finished.
        failures: in how many the defective target failed validly.
        sound_failures: in how many the sound one did.
        only_defect: in how many the defective one alone did.
        only_sound: in how many the sound one alone did.
        p: exact McNemar test, one-sided.
        adjusted: the same after Holm over the defects.
    """

    defect: str
    scenes: int
    failures: int
    sound_failures: int
    only_defect: int
    only_sound: int
    p: float
    adjusted: float

    @property
    def detected(self) -> bool:
        """Whether its failures exceed the sound planner's."""
        return self.adjusted < LEVEL


@dataclass(frozen=True)
class FirstDetection:
    """When the first defect was detected.

    Attributes:
        defects: those detected then.
        scenes: tried until then.
        episodes: of the sound target and of all defects in them.
        cpu_s: processor time of these.
    """

    defects: tuple[str, ...]
    scenes: int
    episodes: int
    cpu_s: float


def detections(sound: Tried, defective: Mapping[str, Tried]) -> tuple[Detection, ...]:
    """Return how each of *defective* compares with *sound*, in their order."""
    counted = []
    for name, tried in defective.items():
        pairs = [(one.failed, sound[scene].failed) for scene, one in tried.items() if scene in sound]
        counted.append((name, pairs, pairs.count((True, False)), pairs.count((False, True))))
    p_values = [mcnemar_more(only_defect, only_sound) for *_, only_defect, only_sound in counted]
    return tuple(
        Detection(
            defect=name,
            scenes=len(pairs),
            failures=sum(failed for failed, _ in pairs),
            sound_failures=sum(failed for _, failed in pairs),
            only_defect=only_defect,
            only_sound=only_sound,
            p=p,
            adjusted=adjusted,
        )
        for (name, pairs, only_defect, only_sound), p, adjusted in zip(
            counted, p_values, holm(p_values), strict=True
        )
    )


def least_scenes(planted: int) -> int:
    """Return in how many scenes, the sound target failing in none, one of *planted* defects must fail to be seen."""
    scenes = 1
    while holm([mcnemar_more(scenes, 0)] * planted)[0] >= LEVEL:
        scenes += 1
    return scenes


def too_few(scenes: int, target: str, planted: int) -> str:
    """Return a sentence where so many *scenes* cannot detect any defect, whatever fails in them; else ""."""
    if not planted or (least := least_scenes(planted)) <= scenes:
        return ""
    p = holm([mcnemar_more(scenes, 0)] * planted)[0]
    few = "1 seed scene is" if scenes == 1 else f"{scenes} seed scenes are"
    which = "the defect" if planted == 1 else f"any of the {planted} defects"
    return (
        f"{few} too few to detect {which} planted in {target}, even with a valid failure in every scene and none of "
        f"the sound target: p = {p:.2g} after Holm's correction, {LEVEL:g} or more. {least} would be enough for that."
    )


def first_detection(sound: Tried, defective: Mapping[str, Tried]) -> FirstDetection | None:
    """Return after how many of the sound target's scenes, in their order, a defect is detected; None for never."""
    for count in range(1, len(sound) + 1):
        scenes = dict(islice(sound.items(), count))
        parts = {
            name: {s: one for s, one in tried.items() if s in scenes} for name, tried in defective.items()
        }
        names = tuple(one.defect for one in detections(scenes, parts) if one.detected)
        if names:
            outcomes = [one for tried in (scenes, *parts.values()) for one in tried.values()]
            return FirstDetection(names, count, len(outcomes), sum(one.cpu_s for one in outcomes))
    return None


def ranking_auc(sound: Sequence[float], defective: Sequence[float]) -> float | None:
    """Return how often the valid-failure rate of a defective planner exceeds a sound one's, a tie counting half.

    That is the area under the ROC curve of the rate as a judge of planners (Hanley and McNeil 1982,
    doi:10.1148/radiology.143.1.7063747): 1 where every defective planner ranks above every sound one.

    Args:
        sound: rates of sound planners.
        defective: rates of planners with a defect; None is returned where either is empty.
    """
    pairs = [(d > s) + 0.5 * (d == s) for d in defective for s in sound]
    return sum(pairs) / len(pairs) if pairs else None
