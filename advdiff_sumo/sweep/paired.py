"""Compare two runs or sweeps on the same seed scenes, episode by episode."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.errors import ConfigError, did_you_mean
from advdiff_sumo.metrics.severity import has_outcome
from advdiff_sumo.metrics.statistics import TAILS, Rate, bootstrap_counts, mcnemar, widened_interval
from advdiff_sumo.sweep.summary_stats import EVENTS, Row

_CELL_COLUMNS = ("target", "target_options", "background", "background_options")
_COMPARED = (
    "min_ttc_s",
    "min_pet_s",
    "min_clearance_m",
    "max_drac_mps2",
    "brake_max_mps2",
    "route_progress_m",
)
_SIDE_NAMES = {"--a": "first", "--b": "second"}
_RESAMPLES = 10_000
_COUNTS = ("pairs", "scenes", "unpaired", "unpaired_a", "unpaired_b", "failures_a", "failures_b")
_RATE_PARTS = ("a", "b", "only_a", "only_b", "change", "change_low", "change_high", "p")
#: Every name that a condition on a comparison may use.
COMPARED_NAMES = frozenset({*_COUNTS, *(f"{rate}_{part}" for rate in EVENTS for part in _RATE_PARTS)})
_MAX_CHOICES = 4


class NothingFinishedError(ConfigError):
    """No episode finished to compare; a condition on the comparison counts as met."""


@dataclass(frozen=True)
class RateChange:
    """Difference of a rate between the two.

    Attributes:
        a: rate in the first's episodes of the pairs.
        b: rate in the second's.
        only_a: pairs with the event in the first only.
        only_b: pairs with the event in the second only.
        low: lower end of the 95 % bootstrap interval of the difference b − a; if it is the same in all pairs, see
            :func:`~advdiff_sumo.metrics.statistics.widened_interval`.
        high: upper end.
        p: p-value of the exact McNemar test, two-sided (doi:10.1007/BF02295996); 1 without discordant pairs.
        episodes_a: numbers of the first's episodes of *only_a*.
        episodes_b: numbers of the second's episodes of *only_b*.
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
    """Difference of a value over the pairs in which both have it.

    Attributes:
        pairs: number of pairs.
        mean: mean of the differences b − a.
        low: lower end of the mean's 95 % bootstrap interval.
        high: upper end.
    """

    pairs: int
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """Paired comparison of two runs or sweeps.

    Attributes:
        pairs: number of pairs: both episodes have an outcome (finished, or failed after a collision of the target).
        scenes: number of seed scenes in them, from which the bootstrap draws.
        unpaired_a: episodes of the first without an outcome, or without a counterpart that has one.
        unpaired_b: the same of the second.
        failures_a: episodes of *unpaired_a* that failed themselves.
        failures_b: episodes of *unpaired_b* that failed themselves.
        rates: changes of rates by name.
        values: changes of values by column; columns without a pair are left out.
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
        """Number of episodes of either that are in no pair."""
        return self.unpaired_a + self.unpaired_b

    def named(self) -> dict[str, float | None]:
        """Return every figure of ``COMPARED_NAMES``; None if no episode has it."""
        named: dict[str, float | None] = dict.fromkeys(COMPARED_NAMES)
        named |= {name: getattr(self, name) for name in _COUNTS}
        for name, event in EVENTS.items():
            if (rate := self.rates.get(event.label)) is not None:
                counts = (rate.a.share, rate.b.share, rate.only_a, rate.only_b)
                figures = (*counts, rate.change, rate.low, rate.high, rate.p)
                named |= {f"{name}_{part}": figure for part, figure in zip(_RATE_PARTS, figures, strict=True)}
        return named


def choose(rows: Sequence[Row], conditions: Sequence[str], what: str) -> list[Row]:
    """Return the rows that meet all *conditions* ``column=value``; *what* is the option, for messages.

    Raises:
        ConfigError: a column does not exist, or no row is left.
    """
    chosen = list(rows)
    for condition in conditions if rows else ():
        column, value = _column_and_value(condition, rows, what)
        values = {str(row[column]) for row in chosen}
        chosen = [row for row in chosen if str(row[column]) == value]
        if not chosen:
            problem = "none of its episodes is so"
            raise ConfigError(f"{what} {condition}: {problem}; {did_you_mean(value, values)}")
    return chosen


def _column_and_value(condition: str, rows: Sequence[Row], what: str) -> tuple[str, str]:
    """Return the parts of the *condition* ``column=value`` on a column of *rows*, of which there is one at least."""
    column, equals, value = condition.partition("=")
    if equals and column in rows[0]:
        return column, value
    if equals:
        raise ConfigError(f"{what} {condition}: no such column; {did_you_mean(column, rows[0])}")
    meant = next((name for name in _CELL_COLUMNS if any(row.get(name) == condition for row in rows)), None)
    if meant is not None:
        remedy = f"did you mean {meant}={condition}?"
    elif column in rows[0]:
        remedy = f"such as {shlex.quote(f'{column}={rows[0][column]}')}"
    else:
        remedy = did_you_mean(column, rows[0])
    raise ConfigError(f"{what} {condition}: expected COLUMN=VALUE; {remedy}")


def compare(first: Sequence[Row], second: Sequence[Row], seed: int = 0) -> Comparison:
    """Pair the episodes with an outcome by seed scene, and by target or background if both have the same ones.

    Args:
        first: rows of ``episodes`` of the first run or sweep.
        second: rows of the second.
        seed: seed of the bootstrap.

    Raises:
        NothingFinishedError: in no seed scene did both finish.
        ConfigError: they share no seed scene, or one of them has several episodes for one side of a pair.
    """
    columns = ("scene_key", *_shared(first, second))
    rows_a, rows_b = _indexed(first, columns, "--a"), _indexed(second, columns, "--b")
    keys = [key for key in rows_a if key in rows_b]
    if not keys:
        raise ConfigError(
            "the two share no seed scene; compare runs or sweeps of the same nets, seeds, horizon_s, sim and scene"
        )
    paired_keys = [key for key in keys if has_outcome(rows_a[key]) and has_outcome(rows_b[key])]
    if not paired_keys:
        raise NothingFinishedError("no seed scene was finished in both")
    pairs = [(rows_a[key], rows_b[key]) for key in paired_keys]
    draws = _Bootstrap([key[0] for key in paired_keys], seed)
    return Comparison(
        pairs=len(pairs),
        scenes=draws.scenes,
        unpaired_a=len(first) - len(pairs),
        unpaired_b=len(second) - len(pairs),
        failures_a=sum(not has_outcome(row) for row in first),
        failures_b=sum(not has_outcome(row) for row in second),
        rates={
            event.label: _rate(pairs, draws, event.happened)
            for event in EVENTS.values()
            if all(row.get(event.known_by, "") is not None for pair in pairs for row in pair)
        },
        values=_values(pairs, draws),
    )


def _shared(first: Sequence[Row], second: Sequence[Row]) -> list[str]:
    """Return the columns of target and background, each pair only if both sides have the same values in it."""
    groups = (_CELL_COLUMNS[:2], _CELL_COLUMNS[2:])
    shared: list[str] = []
    for group in groups:
        sides = [{tuple(row[column] for column in group) for row in rows} for rows in (first, second)]
        if sides[0] == sides[1]:
            shared.extend(group)
    return shared


def _indexed(rows: Sequence[Row], columns: Sequence[str], side: str) -> dict[tuple[str, ...], Row]:
    """Return *rows* by their values of *columns*, which must be unique."""
    indexed: dict[tuple[str, ...], Row] = {}
    for row in rows:
        first = indexed.setdefault(tuple(str(row[column]) for column in columns), row)
        if first is not row:
            raise ConfigError(
                f"the {_SIDE_NAMES[side]} sweep has several episodes for one seed scene; "
                f"choose among them{_choices(rows, first, row, side)}"
            )
    return indexed


def _choices(rows: Sequence[Row], first: Row, second: Row, side: str) -> str:
    """Return the filters that separate the rows *first* and *second*, as the end of a sentence."""
    for column in _CELL_COLUMNS:
        if first[column] != second[column]:
            earlier = _CELL_COLUMNS[: _CELL_COLUMNS.index(column)]
            alike = [row for row in rows if all(row[c] == first[c] for c in earlier)]
            values = list(dict.fromkeys(str(row[column]) for row in alike))
            filters = [f"{side} {shlex.quote(f'{column}={value}')}" for value in values[:_MAX_CHOICES]]
            return f": add {' or '.join(filters)}{', …' if len(values) > _MAX_CHOICES else ''}"
    return ""


class _Bootstrap:
    """Bootstrap over seed scenes: the episodes of one scene are always drawn together."""

    def __init__(self, scenes: Sequence[str], seed: int) -> None:
        names = list(dict.fromkeys(scenes))
        index = {name: k for k, name in enumerate(names)}
        self.scenes = len(names)
        self.scene_of = np.array([index[name] for name in scenes])
        self._rng_seed = seed

    def interval(self, differences: FloatArray, chosen: Sequence[int]) -> tuple[float, float]:
        """Return the percentile interval of the mean of *differences*, one for each of the pairs *chosen*."""
        scene = self.scene_of[np.asarray(chosen)]
        total = np.bincount(scene, weights=differences, minlength=self.scenes)
        count = np.bincount(scene, minlength=self.scenes).astype(np.float64)
        has_pairs = count > 0
        total, count = total[has_pairs], count[has_pairs]
        samples = bootstrap_counts(len(total), self._rng_seed, _RESAMPLES)
        means = [(weights @ total) / (weights @ count) for weights in samples]
        low, high = np.percentile(np.concatenate(means), TAILS)
        return float(low), float(high)


def _rate(pairs: Sequence[tuple[Row, Row]], draws: _Bootstrap, happened: Callable[[Row], bool]) -> RateChange:
    """Return the change of the rate of an event."""
    flags = np.array([[happened(a), happened(b)] for a, b in pairs], dtype=np.float64)
    outcomes = Counter((bool(a), bool(b)) for a, b in flags)
    only_a, only_b = outcomes[(True, False)], outcomes[(False, True)]
    low, high = widened_interval(*draws.interval(flags[:, 1] - flags[:, 0], range(len(pairs))), draws.scenes)
    count = len(pairs)
    a, b = (Rate.of(int(flags[:, side].sum()), count) for side in (0, 1))
    episodes_alone = [
        tuple(
            int(pair[side]["episode"])
            for pair, flag in zip(pairs, flags, strict=True)
            if flag[side] > flag[1 - side]
        )
        for side in (0, 1)
    ]
    return RateChange(a, b, only_a, only_b, low, high, mcnemar(only_a, only_b), *episodes_alone)


def _values(pairs: Sequence[tuple[Row, Row]], draws: _Bootstrap) -> dict[str, ValueChange]:
    """Return the changes of the values in the columns ``_COMPARED``."""
    changes = {}
    for column in _COMPARED:
        chosen = [k for k, (a, b) in enumerate(pairs) if a[column] is not None and b[column] is not None]
        if chosen:
            differences = np.array([float(pairs[k][1][column]) - float(pairs[k][0][column]) for k in chosen])
            low, high = draws.interval(differences, chosen)
            changes[column] = ValueChange(len(chosen), float(differences.mean()), low, high)
    return changes
