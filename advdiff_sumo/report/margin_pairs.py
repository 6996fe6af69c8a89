"""Prepares the margins of a seed scene for the page: each failing episode beside the neighbouring passing one."""

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
"""Duration shown of both episodes, up to the contact of the failing one."""
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Neighbour:
    """One of two episodes side by side.

    Attributes:
        trial: its line of ``margin.csv``.
        row: of ``episodes.parquet``.
        svg: picture of the shown seconds.
        charts: speed in these seconds, and the gap to the attacker, or to the nearest vehicle if it is unknown.
        start_s: first moment of the picture.
        end_s: last moment of the picture.
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
        by: name of the scale of severity.
        trials: all of them, mildest first.
        neighbours: the failing and the passing one; empty unless the run has both.
    """

    attack: str
    by: str
    trials: tuple[TrialRow, ...]
    neighbours: tuple[Neighbour, ...]

    @property
    def fails(self) -> TrialRow | None:
        """The mildest failing trial that has an episode in the folder."""
        return next(
            (trial for trial in self.trials if trial.episode is not None and trial.valid_failure), None
        )

    @property
    def passes(self) -> TrialRow | None:
        """The severest passing trial that has an episode in the folder."""
        passing = [trial for trial in self.trials if trial.episode is not None and not trial.valid_failure]
        return passing[-1] if passing else None


def margins_of(run: FinishedRun, nets: NetLayers) -> list[MarginPair]:
    """Return the margins in the folder of *run*; none if it is not a margin's folder.

    Raises:
        FileError: ``margin.csv`` or the states are damaged.
    """
    trials = read_trials(run.folder)
    groups = groupby(trials, key=lambda trial: (trial.attack, trial.by))
    return [_margin(run, nets, *name, tuple(group)) for name, group in groups]


def _margin(
    run: FinishedRun, nets: NetLayers, attack: str, by: str, trials: tuple[TrialRow, ...]
) -> MarginPair:
    pair = MarginPair(attack, by, trials, ())
    if run.is_part or pair.fails is None or pair.passes is None:
        return pair
    return replace(pair, neighbours=_side_by_side(run, nets, (pair.fails, pair.passes)))


def _side_by_side(
    run: FinishedRun, nets: NetLayers, trials: tuple[TrialRow, TrialRow]
) -> tuple[Neighbour, ...]:
    """Return the two episodes over the same seconds, in the same view and at the same scale."""
    rows = [run.row(trial.episode or 0) for trial in trials]
    end_s = float(rows[0]["collision_time_s"] or rows[0]["duration_s"])
    states = [run.states(int(row["episode"])) for row in rows]
    clipped = [_last_seconds(episode, end_s) for episode in states if episode is not None]
    if len(clipped) < len(rows):
        return ()
    common_attacker = _common_attacker(trials[0], rows[0], clipped)
    names = [common_attacker or attacker_of(row) for row in rows]
    view = _common_view(clipped, names)
    layer = nets.layer(str(rows[0]["net"]))
    pictures = [
        picture_of(episode, row, (), layer, view, name)
        for episode, row, name in zip(clipped, rows, names, strict=True)
    ]
    to_attacker = common_attacker is not None
    series = [_series(episode, name, to_attacker) for episode, name in zip(clipped, names, strict=True)]
    gap = "Gap to the nearest" if common_attacker is None else "Gap to the attacker"
    return tuple(
        Neighbour(trial, row, svg_picture(picture), _charts(own, series, gap), picture.start_s, picture.end_s)
        for trial, row, picture, own in zip(trials, rows, pictures, series, strict=True)
    )


def _last_seconds(states: EpisodeStates, end_s: float) -> EpisodeStates:
    """Return the last ``SHOWN_S`` of *states* up to the first instant at or after *end_s*."""
    tracks = states.tracks
    last = int(np.ceil((end_s - tracks.t0_s) / tracks.dt_s - _ROUNDING)) + 1
    first = int(np.clip(last - 1 - round(SHOWN_S / tracks.dt_s), 0, tracks.steps - 1))
    return replace(states, tracks=tracks.window(first, min(last, tracks.steps)))


def _common_attacker(failing: TrialRow, row: Row, states: Sequence[EpisodeStates]) -> str | None:
    """Return the attacker of the *failing* trial if both episodes contain it; None if it was not involved."""
    name = attacker_of(row) if failing.encounter else None
    return name if all(name in episode.tracks.index for episode in states) else None


def _common_view(states: Sequence[EpisodeStates], names: Sequence[str | None]) -> NetWindow:
    points = [focus_of(episode, name) for episode, name in zip(states, names, strict=True)]
    return NetWindow.around(np.concatenate(points), margin_m=6.0, least_width_m=40.0)


def _series(states: EpisodeStates, name: str | None, to_attacker: bool) -> Series:
    """Return the series with the attacker *name*; with *to_attacker*, its gap is that between target and attacker."""
    series, tracks = series_of(states, name), states.tracks
    if not to_attacker or name is None:
        return series
    return replace(series, gap_m=gap_to(tracks, states.target, tracks.index[name]))


def _charts(series: Series, both_series: Sequence[Series], gap: str) -> tuple[Chart, ...]:
    """Return the charts of speed and gap, the latter titled *gap*, with the same scales for both episodes."""
    fastest = max(float(np.nanmax([*other.speed_mps, *other.attacker_mps])) for other in both_series)
    widest = max(
        (float(np.nanmax(other.gap_m)) for other in both_series if np.isfinite(other.gap_m).any()),
        default=1.0,
    )
    speeds = {"attacker": series.attacker_mps, "target": series.speed_mps}
    return (
        chart("Speed", "m/s", series.times_s, speeds, None, least=(0.0, max(fastest, 1.0))),
        chart(gap, "m", series.times_s, {"target": series.gap_m}, None, least=(0.0, max(widest, 1.0))),
    )
