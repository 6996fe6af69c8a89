"""The margins of a seed scene on the page: each failing episode beside the passing one next to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.report.charts import Chart, chart
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.layer import NetWindow
from advdiff_sumo.report.margin_table import TrialRow, read_trials
from advdiff_sumo.report.nets import NetLayers
from advdiff_sumo.report.scene_picture import focus_of, picture_of
from advdiff_sumo.report.select import attacker_of
from advdiff_sumo.report.series import Series, gap_to, series_of
from advdiff_sumo.report.svg import SvgPicture, svg_picture

SHOWN_S = 6.0
_ROUNDING = 1e-6
"""What is shown of both ends at the contact of the failing one, and is so long."""


@dataclass(frozen=True)
class Neighbour:
    """One of two episodes side by side.

    Attributes:
        trial: its line of ``margin.csv``.
        row: of ``episodes.parquet``.
        svg: its last seconds.
        charts: speed in them, and the gap to who attacks, or to the nearest where nobody is known to.
        start_s: when the picture begins.
        end_s: when it ends.
    """

    trial: TrialRow
    row: Row
    svg: SvgPicture
    charts: tuple[Chart, ...]
    start_s: float
    end_s: float


@dataclass(frozen=True)
class MarginPair:
    """The margin of one attack.

    Attributes:
        attack: its kind.
        by: the severity's name.
        trials: all of them, the mildest first.
        neighbours: the failing one and the passing one; empty where the run has not both.
    """

    attack: str
    by: str
    trials: tuple[TrialRow, ...]
    neighbours: tuple[Neighbour, ...]

    @property
    def fails(self) -> TrialRow | None:
        """The mildest trial known to fail that has an episode here."""
        return next(
            (trial for trial in self.trials if trial.episode is not None and trial.valid_failure), None
        )

    @property
    def passes(self) -> TrialRow | None:
        """The severest trial known to pass that has an episode here."""
        kept = [trial for trial in self.trials if trial.episode is not None and not trial.valid_failure]
        return kept[-1] if kept else None


def margins_of(run: FinishedRun, nets: NetLayers) -> list[MarginPair]:
    """Return the margins in the folder of *run*; none where it is that of another verb.

    Raises:
        FileError: ``margin.csv`` or the states are damaged.
    """
    trials = read_trials(run.folder)
    groups = groupby(trials, key=lambda trial: (trial.attack, trial.by))
    return [_margin(run, nets, *name, tuple(group)) for name, group in groups]


def _margin(
    run: FinishedRun, nets: NetLayers, attack: str, by: str, trials: tuple[TrialRow, ...]
) -> MarginPair:
    alone = MarginPair(attack, by, trials, ())
    if run.is_part or alone.fails is None or alone.passes is None:
        return alone
    return replace(alone, neighbours=_side_by_side(run, nets, (alone.fails, alone.passes)))


def _side_by_side(
    run: FinishedRun, nets: NetLayers, trials: tuple[TrialRow, TrialRow]
) -> tuple[Neighbour, ...]:
    """Return the two episodes over the same seconds, in the same view and at the same scale."""
    rows = [run.row(trial.episode or 0) for trial in trials]
    end_s = float(rows[0]["collision_time_s"] or rows[0]["duration_s"])
    states = [run.states(int(row["episode"])) for row in rows]
    cut = [_last_seconds(one, end_s) for one in states if one is not None]
    if len(cut) < len(rows):
        return ()
    met = _met(trials[0], rows[0], cut)
    names = [met or attacker_of(row) for row in rows]
    view = _common_view(cut, names)
    layer = nets.layer(str(rows[0]["net"]))
    pictures = [
        picture_of(one, row, (), layer, view, name) for one, row, name in zip(cut, rows, names, strict=True)
    ]
    series = [_series(one, name, met is not None) for one, name in zip(cut, names, strict=True)]
    gap = "Gap to the nearest" if met is None else "Gap to the attacker"
    return tuple(
        Neighbour(trial, row, svg_picture(picture), _charts(one, series, gap), picture.start_s, picture.end_s)
        for trial, row, picture, one in zip(trials, rows, pictures, series, strict=True)
    )


def _last_seconds(states: EpisodeStates, end_s: float) -> EpisodeStates:
    tracks = states.tracks
    last = int(np.ceil((end_s - tracks.t0_s) / tracks.dt_s - _ROUNDING)) + 1
    first = int(np.clip(last - 1 - round(SHOWN_S / tracks.dt_s), 0, tracks.steps - 1))
    return replace(states, tracks=tracks.window(first, min(last, tracks.steps)))


def _met(failing: TrialRow, row: Row, states: Sequence[EpisodeStates]) -> str | None:
    """Return who attacks in both episodes: whom the target met in the *failing* one; None where that did nothing."""
    name = attacker_of(row) if failing.encounter else None
    return name if all(name in one.tracks.index for one in states) else None


def _common_view(states: Sequence[EpisodeStates], names: Sequence[str | None]) -> NetWindow:
    points = [focus_of(one, name) for one, name in zip(states, names, strict=True)]
    return NetWindow.around(np.concatenate(points), margin_m=6.0, least_width_m=40.0)


def _series(states: EpisodeStates, name: str | None, to_attacker: bool) -> Series:
    """Return the series with the attacker called *name*, whose gap is that *to_attacker* where that is asked for."""
    series, tracks = series_of(states, name), states.tracks
    if not to_attacker or name is None:
        return series
    return replace(series, gap_m=gap_to(tracks, states.target, tracks.index[name]))


def _charts(series: Series, both: Sequence[Series], gap: str) -> tuple[Chart, ...]:
    """Return charts of speed and of what *gap* says, scaled for both episodes."""
    fastest = max(float(np.nanmax([*one.speed_mps, *one.attacker_mps])) for one in both)
    widest = max((float(np.nanmax(one.gap_m)) for one in both if np.isfinite(one.gap_m).any()), default=1.0)
    speeds = {"attacker": series.attacker_mps, "target": series.speed_mps}
    return (
        chart("Speed", "m/s", series.times_s, speeds, None, least=(0.0, max(fastest, 1.0))),
        chart(
            gap,
            "m",
            series.times_s,
            {"target": series.gap_m},
            None,
            least=(0.0, max(widest, 1.0)),
        ),
    )
