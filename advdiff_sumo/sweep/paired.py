"""Two runs or sweeps over the same seed scenes, episode by episode."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError, did_you_mean
from advdiff_sumo.metrics.severity import has_outcome
from advdiff_sumo.metrics.statistics import TAILS, Rate, bootstrap_counts, mcnemar, spread
from advdiff_sumo.sweep.summary_stats import EVENTS, Row

_KIND = ("target", "target_options", "background", "background_options")
_VALUES = ("min_ttc_s", "min_pet_s", "min_clearance_m", "max_drac_mps2", "brake_max_mps2", "route_progress_m")
_ORDER = {"--a": "first", "--b": "second"}
_RESAMPLES = 10_000
_COUNTS = ("pairs", "scenes", "unpaired", "unpaired_a", "unpaired_b", "failures_a", "failures_b")
_OF_A_RATE = ("a", "b", "only_a", "only_b", "change", "change_low", "change_high", "p")
#: Every name that a condition on a comparison may use.
COMPARED_NAMES = frozenset({*_COUNTS, *(f"{rate}_{part}" for rate in EVENTS for part in _OF_A_RATE)})
_SHOWN = 4


@dataclass(frozen=True)
class RateChange:
    """How a rate differs between the two.

    Attributes:
        a: in the first's episodes of the pairs.
        b: in the second's.
        only_a: pairs in which it happened in the first alone.
        only_b: in the second alone.
        low: lower end of the 95 % bootstrap interval of the difference b − a; where all pairs differ alike see
            :func:`~advdiff_sumo.metrics.statistics.spread`.
        high: upper end.
        p: exact McNemar test, two-sided (doi:10.1007/BF02295996); 1 without discordant pairs.
        episodes_a: numbers of the first's episodes of *only_a*.
        episodes_b: numbers of the second's of *only_b*.
    """

    a: Rate
    b: Rate
    only_a: int
    only_b: int
    low: float
    high: float
    p: float
    episodes_a: tuple[int, ...] = ()
    episodes_b: tuple[int, ...] = ()

    @property
    def change(self) -> float:
        """The difference b − a."""
        return (self.b.share or 0.0) - (self.a.share or 0.0)


@dataclass(frozen=True)
class ValueChange:
    """How a value differs over the pairs in which both have it.

    Attributes:
        pairs: how many.
        mean: of the differences b − a.
        low: lower end of its 95 % bootstrap interval.
        high: upper end.
    """

    pairs: int
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """Two runs or sweeps, paired.

    Attributes:
        pairs: episodes with an outcome in both: finished, or failed after a collision of the target.
        scenes: seed scenes among them; the bootstrap draws these.
        unpaired_a: episodes of the first in no pair: without an outcome, or without a counterpart that has one.
        unpaired_b: of the second.
        failures_a: those of *unpaired_a* that failed themselves.
        failures_b: those of *unpaired_b*.
        rates: by name.
        values: by column; those without a pair are left out.
    """

    pairs: int
    scenes: int
    unpaired_a: int
    unpaired_b: int
    failures_a: int
    failures_b: int
    rates: Mapping[str, RateChange]
    values: Mapping[str, ValueChange]

    @property
    def unpaired(self) -> int:
        """Episodes of either in no pair."""
        return self.unpaired_a + self.unpaired_b

    def named(self) -> dict[str, float | None]:
        """Return every figure of ``COMPARED_NAMES``; None where no episode has it."""
        named: dict[str, float | None] = dict.fromkeys(COMPARED_NAMES)
        named |= {name: getattr(self, name) for name in _COUNTS}
        for name, event in EVENTS.items():
            if (rate := self.rates.get(event.label)) is not None:
                own = (rate.a.share, rate.b.share, rate.only_a, rate.only_b)
                figures = (*own, rate.change, rate.low, rate.high, rate.p)
                named |= {f"{name}_{part}": figure for part, figure in zip(_OF_A_RATE, figures, strict=True)}
        return named


def choose(rows: Sequence[Row], conditions: Sequence[str], what: str) -> list[Row]:
    """Return the rows that meet each ``column=value``.

    Raises:
        ConfigError: a column does not exist, or nothing is left.
    """
    chosen = list(rows)
    for condition in conditions:
        column, equals, value = condition.partition("=")
        holds = next((name for name in _KIND if any(row.get(name) == condition for row in rows)), None)
        if not equals and holds is not None:
            raise ConfigError(f"{what} {condition}: expected COLUMN=VALUE; did you mean {holds}={condition}?")
        if rows and (not equals or column not in rows[0]):
            raise ConfigError(f"{what} {condition}: expected COLUMN=VALUE; {did_you_mean(column, rows[0])}")
        values = {str(row[column]) for row in chosen}
        chosen = [row for row in chosen if str(row[column]) == value]
        if values and not chosen:
            problem = "none of its episodes is so"
            raise ConfigError(f"{what} {condition}: {problem}; {did_you_mean(value, values)}")
    if not rows:
        raise ConfigError(f"the {_ORDER[what]} has no episode with results; its failures say why")
    if not chosen:
        raise ConfigError(f"{what} {' '.join(conditions)}: none of its episodes is so")
    return chosen


def compare(first: Sequence[Row], second: Sequence[Row], seed: int = 0) -> Comparison:
    """Pair the episodes with an outcome of two runs or sweeps by seed scene, and by what else both vary.

    Args:
        first: rows of ``episodes`` of the one.
        second: of the other.
        seed: of the bootstrap.

    Raises:
        ConfigError: they share no seed scene, or several episodes of one of them would be one side of a pair.
    """
    columns = ("scene_key", *_shared(first, second))
    a, b = _indexed(first, columns, "--a"), _indexed(second, columns, "--b")
    keys = [key for key in a if key in b]
    if not keys:
        raise ConfigError(
            "the two share no seed scene; compare runs or sweeps of the same nets, seeds, horizon_s, sim and scene"
        )
    counted = [key for key in keys if has_outcome(a[key]) and has_outcome(b[key])]
    if not counted:
        raise ConfigError("no seed scene was finished in both")
    pairs = [(a[key], b[key]) for key in counted]
    draw = _Draws([key[0] for key in counted], seed)
    return Comparison(
        pairs=len(pairs),
        scenes=draw.scenes,
        unpaired_a=len(first) - len(pairs),
        unpaired_b=len(second) - len(pairs),
        failures_a=sum(not has_outcome(row) for row in first),
        failures_b=sum(not has_outcome(row) for row in second),
        rates={
            event.label: _rate(pairs, draw, event.happened)
            for event in EVENTS.values()
            if all(row.get(event.known_by, "") is not None for pair in pairs for row in pair)
        },
        values=_values(pairs, draw),
    )


def _shared(first: Sequence[Row], second: Sequence[Row]) -> list[str]:
    """Return the columns that tell episodes of a scene apart in the same way in both."""
    groups = (_KIND[:2], _KIND[2:])
    shared: list[str] = []
    for group in groups:
        sides = [{tuple(row[column] for column in group) for row in rows} for rows in (first, second)]
        if sides[0] == sides[1]:
            shared.extend(group)
    return shared


def _indexed(rows: Sequence[Row], columns: Sequence[str], side: str) -> dict[tuple[str, ...], Row]:
    indexed: dict[tuple[str, ...], Row] = {}
    for row in rows:
        twin = indexed.setdefault(tuple(str(row[column]) for column in columns), row)
        if twin is not row:
            raise ConfigError(
                f"the {_ORDER[side]} sweep has several episodes for one seed scene; "
                f"choose among them{_choices(rows, twin, row, side)}"
            )
    return indexed


def _choices(rows: Sequence[Row], one: Row, other: Row, side: str) -> str:
    """Return the filters of which one tells *one* row from the *other*."""
    for column in _KIND:
        if one[column] != other[column]:
            alike = [row for row in rows if all(row[c] == one[c] for c in _KIND[: _KIND.index(column)])]
            values = list(dict.fromkeys(str(row[column]) for row in alike))
            some = [f"{side} {shlex.quote(f'{column}={value}')}" for value in values[:_SHOWN]]
            return f": add {' or '.join(some)}{', …' if len(values) > _SHOWN else ''}"
    return ""


class _Draws:
    """Bootstrap over seed scenes: episodes of one scene are drawn together."""

    def __init__(self, scenes: Sequence[str], seed: int) -> None:
        names = list(dict.fromkeys(scenes))
        place = {name: k for k, name in enumerate(names)}
        self.scenes = len(names)
        self.scene_of = np.array([place[name] for name in scenes])
        self._rng_seed = seed

    def interval(self, differences: FloatArray, chosen: Sequence[int]) -> tuple[float, float]:
        """Return the percentile interval of the mean of *differences*, which are of the pairs *chosen*."""
        scene = self.scene_of[np.asarray(chosen)]
        total = np.bincount(scene, weights=differences, minlength=self.scenes)
        count = np.bincount(scene, minlength=self.scenes).astype(np.float64)
        there = count > 0
        total, count = total[there], count[there]
        samples = bootstrap_counts(len(total), self._rng_seed, _RESAMPLES)
        means = [(times @ total) / (times @ count) for times in samples]
        low, high = np.percentile(np.concatenate(means), TAILS)
        return float(low), float(high)


def _rate(pairs: Sequence[tuple[Row, Row]], draw: _Draws, happened: Callable[[Row], bool]) -> RateChange:
    flags = np.array([[happened(a), happened(b)] for a, b in pairs], dtype=np.float64)
    both = Counter((bool(a), bool(b)) for a, b in flags)
    only_a, only_b = both[(True, False)], both[(False, True)]
    low, high = spread(*draw.interval(flags[:, 1] - flags[:, 0], range(len(pairs))), draw.scenes)
    n = len(pairs)
    a, b = (Rate.of(int(flags[:, side].sum()), n) for side in (0, 1))
    alone = [
        tuple(
            int(pair[side]["episode"])
            for pair, own in zip(pairs, flags, strict=True)
            if own[side] > own[1 - side]
        )
        for side in (0, 1)
    ]
    return RateChange(a, b, only_a, only_b, low, high, mcnemar(only_a, only_b), *alone)


def _values(pairs: Sequence[tuple[Row, Row]], draw: _Draws) -> dict[str, ValueChange]:
    changes = {}
    for column in _VALUES:
        chosen = [k for k, (a, b) in enumerate(pairs) if a[column] is not None and b[column] is not None]
        if chosen:
            differences = np.array([float(pairs[k][1][column]) - float(pairs[k][0][column]) for k in chosen])
            low, high = draw.interval(differences, chosen)
            changes[column] = ValueChange(len(chosen), float(differences.mean()), low, high)
    return changes
