"""The margin of a seed scene: the least severe encounter that makes a target fail validly, by bisection.

Each kind of attack has severities (``SCALES``): how hard somebody brakes, with what gap somebody cuts in, how long
before the target somebody crosses, how late a leader reveals somebody who stands. The seed scene, the place and who
attacks stay the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from advdiff_sumo.core.errors import ConfigError
from advdiff_sumo.traffic.manoeuvres.intensity import (
    BRAKING_KINDS,
    LEAST_REVEALS_S,
    MOST_EARLY_S,
    MOST_REVEALS_S,
    MOST_SPARE_GAP_M,
)

EVERY_ATTACK = "all"
_OFF_THE_ROAD = "it leaves the road by itself and touches nobody"
_REMEDY = "raise scene.min_speed_mps or choose a scene.situation with --set, or take another --seed or --net"
_BESIDE_THE_ATTACK = "it collides with somebody who does nothing against it"


@dataclass(frozen=True)
class Scale:
    """A severity of an attack.

    Attributes:
        by: its name on the command line.
        option: of the background ``scripted``.
        unit: of its values.
        mildest: value at which hardly anybody fails.
        severest: value at the other end; less than the mildest where a small one is severe.
        within: how near the two neighbours come, if nobody says otherwise.
        words: what a value is.
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
    "cut-in": (GAP, BRAKING),
    "crossing": (TIME,),
    "cut-out": (REVEAL,),
}
"""Kind of attack → its severities, the first one unless another is asked for."""


def scale_of(attack: str, by: str | None = None) -> Scale:
    """Return the severity called *by* of *attack*; None: its first.

    Raises:
        ConfigError: there is none.
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
    """An episode with one severity.

    Attributes:
        value: of the severity.
        failed: whether the target failed validly.
        met: whether the encounter took place at all; where it failed, whether it met who attacks, and nobody else.
        left_road: whether it failed by leaving the road, which it does without colliding with anybody.
        lacks: why no encounter took place, in words; "" where that is not known.
    """

    value: float
    failed: bool
    met: bool
    left_road: bool = False
    lacks: str = ""

    @property
    def outcome(self) -> str:
        """What came of it, in words."""
        if self.failed:
            return "valid failure" if self.met else f"valid failure, but {self.apart}"
        return "no valid failure" if self.met else "no encounter"

    @property
    def apart(self) -> str:
        """How it fails where it does not meet who attacks, in words."""
        return _OFF_THE_ROAD if self.left_road else _BESIDE_THE_ATTACK


@dataclass(frozen=True)
class Margin:
    """What a bisection came to; at least one of the two is known.

    Attributes:
        passes: severest trial that the target coped with; None: it failed at the mildest.
        fails: mildest trial in which it failed; None: it coped with the severest.
        trials: in their order.
    """

    passes: Trial | None
    fails: Trial | None
    trials: tuple[Trial, ...]

    @property
    def neighbours(self) -> tuple[Trial, ...]:
        """The failing and the passing one that lie side by side, as far as there are both."""
        return tuple(trial for trial in (self.fails, self.passes) if trial is not None)

    @property
    def is_known(self) -> bool:
        """Whether it is a margin or a bound of one; not where the severest attack did not take place."""
        return self.fails is not None or (self.passes is not None and self.passes.met)

    def text(self, attack: str, scale: Scale) -> str:
        """Return the margin of *attack* in a sentence's end."""
        if self.fails is None and self.passes is not None:
            if not self.is_known:
                why = f": {self.passes.lacks}" if self.passes.lacks else ""
                return f"nobody was in a position for {attack}{why}; {_REMEDY}"
            return f"copes with {attack} up to the severest, {scale.text(self.passes.value)}"
        if self.passes is None and self.fails is not None:
            other = "" if self.fails.met else f": {self.fails.apart}"
            return f"fails at the mildest {attack} already, {scale.text(self.fails.value)}{other}"
        passes, fails = (
            scale.text(trial.value) + ("" if trial.met else f" ({trial.outcome})")
            for trial in reversed(self.neighbours)
        )
        return f"copes with {attack} at {passes} and fails at {fails}"


def bisect(run: Callable[[float], Trial], scale: Scale, within: float | None = None) -> Margin:
    """Return where a target begins to fail between the mildest and the severest value of *scale*.

    The ends are tried first, then values on a grid. Where it fails in several stretches, one beginning is found.

    Args:
        run: makes the trial of a value.
        scale: the severity.
        within: how near the neighbours come, in its unit; None: as the scale says.
    """
    trials: list[Trial] = []
    span, step_size = scale.severest - scale.mildest, within or scale.within
    steps = max(math.ceil(abs(span) / step_size - 1e-9), 1)

    def tried(step: int) -> Trial:
        back = min((steps - step) * step_size, abs(span))  # a grid that begins at the severest
        trials.append(run(round(scale.severest - math.copysign(back, span), 6)))
        return trials[-1]

    high, fails = steps, tried(steps)
    if not fails.failed:
        return Margin(fails, None, tuple(trials))
    low, passes = 0, tried(0)
    if passes.failed:
        return Margin(None, passes, tuple(trials))
    while high - low > 1:
        middle = (low + high) // 2
        trial = tried(middle)
        if trial.failed:
            high, fails = middle, trial
        else:
            low, passes = middle, trial
    return Margin(passes, fails, tuple(trials))
