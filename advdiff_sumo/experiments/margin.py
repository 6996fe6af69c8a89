"""The margin of a seed scene: the least severe encounter that makes a target fail validly, by bisection.

Each kind of attack has scales of severity (``SCALES``): the deceleration of a braking vehicle, the gap at an entry,
the time by which a crossing vehicle precedes the target, or how late a leader's cut-out reveals a vehicle.
The seed scene, the place and the attacker stay the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.traffic.manoeuvres.intensity import (
    BRAKING_KINDS,
    GAP_KINDS,
    LEAST_REVEALS_S,
    MOST_EARLY_S,
    MOST_REVEALS_S,
    MOST_SPARE_GAP_M,
    ONCOMING,
)

EVERY_ATTACK = "all"
_LEAVES_ROAD = "it leaves the road by itself and touches nobody"
_REMEDY = "raise scene.min_speed_mps or choose a scene.situation with --set, or take another --seed or --net"
_DESCENTS = 8  # of a range from its severest to its mildest value
_HITS_BYSTANDER = "it collides with somebody who does nothing against it"


@dataclass(frozen=True)
class Scale:
    """A scale of severity of an attack.

    Attributes:
        by: its name on the command line.
        option: of the background ``scripted``.
        unit: of its values.
        mildest: value at which hardly any planner fails.
        severest: value at the other end; below the mildest if small values are severe.
        within: default distance of the passing and the failing value at the end of the bisection.
        words: template of a value in words.
    """

    by: str
    option: str
    unit: str
    mildest: float
    severest: float
    within: float
    words: str

    def text(self, value: float) -> str:
        """Return *value* in words."""
        return self.words.format(f"{value:g} {self.unit}")


BRAKING = Scale("braking", "braking_mps2", "m/s²", 1.0, 8.5, 0.25, "braking of {}")
GAP = Scale("gap", "spare_gap_m", "m", MOST_SPARE_GAP_M, 0.0, 1.0, "{} beyond the lawful gap")
TIME = Scale("time", "early_s", "s", MOST_EARLY_S, 0.0, 0.05, "{} before the target")
REVEAL = Scale(
    "time",
    "reveals_s",
    "s",
    MOST_REVEALS_S,
    LEAST_REVEALS_S,
    0.1,
    "{} before the leader would reach who stands",
)
SCALES: Mapping[str, tuple[Scale, ...]] = {
    **dict.fromkeys(BRAKING_KINDS, (BRAKING,)),
    **dict.fromkeys(GAP_KINDS, (GAP,)),
    "cut-in": (GAP, BRAKING),
    "crossing": (TIME,),
    ONCOMING: (TIME,),
    "cut-out": (REVEAL,),
}
"""Kind of attack → its scales of severity; the first is the default."""


def scale_of(attack: str, by: str | None = None) -> Scale:
    """Return the scale named *by* of *attack*; None: its first.

    Raises:
        ConfigError: the attack has no such scale, or none at all.
    """
    if attack not in SCALES:
        raise ConfigError(
            f"--attack {attack}: a margin is known for {', '.join(SCALES)}; choose one of them, or {EVERY_ATTACK}"
        )
    scales = {scale.by: scale for scale in SCALES[attack]}
    if by is not None and by not in scales:
        raise ConfigError(f"--by {by}: {attack} is as severe as its {' or '.join(scales)}; choose that")
    return scales[by or SCALES[attack][0].by]


@dataclass(frozen=True)
class Trial:
    """An episode with one value of severity.

    Attributes:
        value: of the severity.
        failed: whether it ended in a valid failure.
        met: without failure: whether the encounter took place. With one: whether the attacker was involved in it.
        left_road: whether the target failed by leaving the road, without a collision.
        lacks: why no encounter took place, in words; "" if that is not known.
    """

    value: float
    failed: bool
    met: bool
    left_road: bool = False
    lacks: str = ""

    @property
    def outcome(self) -> str:
        """Its outcome, in words."""
        if self.failed:
            return "valid failure" if self.met else f"valid failure, but {self.apart}"
        return "no valid failure" if self.met else "no encounter"

    @property
    def apart(self) -> str:
        """How the target failed without involvement of the attacker, in words."""
        return _LEAVES_ROAD if self.left_road else _HITS_BYSTANDER


@dataclass(frozen=True)
class Margin:
    """The result of a bisection; at least one of *passes* and *fails* is known.

    Attributes:
        passes: the severest passed trial below *fails*; None: the target failed at the mildest value.
        fails: the mildest failed trial of the bisection; None: the target passed at the severest value.
        trials: in the order in which they were run.
    """

    passes: Trial | None
    fails: Trial | None
    trials: tuple[Trial, ...]

    @property
    def neighbours(self) -> tuple[Trial, ...]:
        """The failing and the passing trial that are adjacent, as far as they exist."""
        return tuple(trial for trial in (self.fails, self.passes) if trial is not None)

    @property
    def is_known(self) -> bool:
        """Whether the margin or a bound of it is known; it is not if the severest attack did not take place."""
        return self.fails is not None or (self.passes is not None and self.passes.met)

    def text(self, attack: str, scale: Scale) -> str:
        """Return the margin of *attack* as the predicate of a sentence."""
        if self.fails is None and self.passes is not None:
            if not self.is_known:
                reason = f": {self.passes.lacks}" if self.passes.lacks else ""
                return f"nobody was in a position for {attack}{reason}; {_REMEDY}"
            if self.trials and self.passes.value != self.trials[0].value:
                severest = scale.text(self.passes.value)
                return f"copes with {attack} up to {severest}; a more severe one did not take place"
            return f"copes with {attack} up to the severest, {scale.text(self.passes.value)}"
        if self.passes is None and self.fails is not None:
            explanation = "" if self.fails.met else f": {self.fails.apart}"
            return f"fails at the mildest {attack} already, {scale.text(self.fails.value)}{explanation}"
        passes, fails = (
            scale.text(trial.value) + ("" if trial.met else f" ({trial.outcome})")
            for trial in reversed(self.neighbours)
        )
        return f"copes with {attack} at {passes} and fails at {fails}"


def bisect(
    run: Callable[[float], Trial], scale: Scale, within: float | None = None, descends: bool = False
) -> Margin:
    """Find where a target begins to fail between the mildest and the severest value of *scale*.

    The ends are tried first, then values on a grid. If it fails in several separate ranges, one of their limits is
    found.

    Args:
        run: runs the trial of a value.
        scale: of the severity.
        within: distance of the neighbouring values at the end, in the scale's unit; None: the scale's default.
        descends: whether milder values are tried, down to the middle, where the severest attacks do not take place.
    """
    trials: list[Trial] = []
    span, step_size = scale.severest - scale.mildest, within or scale.within
    steps = max(math.ceil(abs(span) / step_size - 1e-9), 1)

    def run_step(step: int) -> Trial:
        below_severest = min((steps - step) * step_size, abs(span))  # the grid begins at the severest value
        trials.append(run(round(scale.severest - math.copysign(below_severest, span), 6)))
        return trials[-1]

    high, fails = steps, run_step(steps)
    while descends and not (fails.failed or fails.met) and high > steps // 2:
        high -= max(steps // _DESCENTS, 1)
        fails = run_step(high)
    if not fails.failed:
        return Margin(fails, None, tuple(trials))
    low, passes = 0, run_step(0)
    if passes.failed:
        return Margin(None, passes, tuple(trials))
    while high - low > 1:
        middle = (low + high) // 2
        trial = run_step(middle)
        if trial.failed:
            high, fails = middle, trial
        else:
            low, passes = middle, trial
    return Margin(passes, fails, tuple(trials))
