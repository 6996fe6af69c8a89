"""Tests which defects a background detects: compares valid failures with the sound planner's, scene by scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from operator import attrgetter
from typing import Any, TypeAlias

from advdiff_sumo.metrics.severity import broke_rule, is_valid_failure
from advdiff_sumo.metrics.statistics import holm, mcnemar_more

LEVEL = 0.05
"""A defect is detected if its adjusted p is below this level."""


@dataclass(frozen=True)
class EpisodeOutcome:
    """The outcome of an episode.

    Attributes:
        failed: it ended in a valid failure.
        cpu_s: its processor time.
        broke_rule: the target broke a rule, with or without a collision.
    """

    failed: bool
    cpu_s: float = 0.0
    broke_rule: bool = False

    @staticmethod
    def of(row: Mapping[str, Any], cpu_s: float | None) -> EpisodeOutcome:
        """Return the outcome of a row of ``episodes``; a collision that cannot be judged is no valid failure."""
        return EpisodeOutcome(is_valid_failure(row), cpu_s or 0.0, broke_rule(row))


SceneOutcomes: TypeAlias = Mapping[str, EpisodeOutcome]
"""Seed scene → outcome of its episode, in the order of the scenes."""


@dataclass(frozen=True)
class Detection:
    """The test of one defect with one background, by valid failures or by another event.

    Attributes:
        defect: its name with its severity.
        scenes: number of scenes that both targets finished.
        failures: scenes with a valid failure (or the event) of the defective target.
        sound_failures: scenes with one of the sound target.
        only_defect: scenes in which only the defective target failed.
        only_sound: scenes in which only the sound target failed.
        p: exact McNemar test, one-sided.
        adjusted: *p* after Holm's correction over the defects.
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
        """Whether they significantly exceed the sound planner's."""
        return self.adjusted < LEVEL


@dataclass(frozen=True)
class FirstDetection:
    """The effort until the first defect was detected.

    Attributes:
        defects: those detected first.
        scenes: number of scenes until then.
        episodes: number of episodes of the sound target and of all defects in these scenes.
        cpu_s: processor time of these episodes.
    """

    defects: tuple[str, ...]
    scenes: int
    episodes: int
    cpu_s: float


def detections(
    sound: SceneOutcomes, defective: Mapping[str, SceneOutcomes], event: str = "failed"
) -> tuple[Detection, ...]:
    """Return the test of each of *defective* against *sound*, in their order.

    Args:
        sound: outcomes of the sound target.
        defective: outcomes with each defect.
        event: what is compared, a flag of :class:`EpisodeOutcome`.
    """
    has_event: Callable[[EpisodeOutcome], bool] = attrgetter(event)
    comparisons = []
    for name, outcomes in defective.items():
        pairs = [
            (has_event(outcome), has_event(sound[scene]))
            for scene, outcome in outcomes.items()
            if scene in sound
        ]
        comparisons.append((name, pairs, pairs.count((True, False)), pairs.count((False, True))))
    p_values = [mcnemar_more(only_defect, only_sound) for *_, only_defect, only_sound in comparisons]
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
            comparisons, p_values, holm(p_values), strict=True
        )
    )


def least_scenes(planted: int) -> int:
    """Return how many failed scenes are needed to detect one of *planted* defects if the sound target never fails."""
    scenes = 1
    while holm([mcnemar_more(scenes, 0)] * planted)[0] >= LEVEL:
        scenes += 1
    return scenes


def too_few_scenes(scenes: int, target: str, planted: int) -> str:
    """Return a warning if no defect can be detected in so few *scenes*, whatever their outcomes; else ""."""
    if not planted or (least := least_scenes(planted)) <= scenes:
        return ""
    p = holm([mcnemar_more(scenes, 0)] * planted)[0]
    few = "1 seed scene is" if scenes == 1 else f"{scenes} seed scenes are"
    which = "the defect" if planted == 1 else f"any of the {planted} defects"
    return (
        f"{few} too few to detect {which} planted in {target}, even with a valid failure in every scene and none of "
        f"the sound target: p = {p:.2g} after Holm's correction, {LEVEL:g} or more. {least} would be enough for that."
    )


def first_detection(sound: SceneOutcomes, defective: Mapping[str, SceneOutcomes]) -> FirstDetection | None:
    """Return the effort until a defect is detected, adding the sound target's scenes one by one; None: never."""
    for count in range(1, len(sound) + 1):
        scenes = dict(islice(sound.items(), count))
        so_far = {
            name: {scene: outcome for scene, outcome in planner.items() if scene in scenes}
            for name, planner in defective.items()
        }
        names = tuple(test.defect for test in detections(scenes, so_far) if test.detected)
        if names:
            outcomes = [outcome for planner in (scenes, *so_far.values()) for outcome in planner.values()]
            return FirstDetection(names, count, len(outcomes), sum(outcome.cpu_s for outcome in outcomes))
    return None


def ranking_auc(sound: Sequence[float], defective: Sequence[float]) -> float | None:
    """Return how well rates of valid failures separate defective from sound planners.

    It is the share of pairs in which the defective planner's rate exceeds the sound one's; ties count half. This is the
    area under the ROC curve (Hanley and McNeil 1982, doi:10.1148/radiology.143.1.7063747): 1 if every defective planner
    ranks above every sound one.

    Args:
        sound: rates of sound planners.
        defective: rates of planners with a defect. None is returned if either is empty.
    """
    pairs = [(d > s) + 0.5 * (d == s) for d in defective for s in sound]
    return sum(pairs) / len(pairs) if pairs else None
