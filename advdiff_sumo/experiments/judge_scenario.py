"""Judges one road user of a recorded or exported scenario, on a net that is given separately."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from advdiff_sumo.core.boxes import corners
from advdiff_sumo.core.errors import FileError, did_you_mean
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data import open_log
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.experiments.solvable import solvable
from advdiff_sumo.export import ImportedScene, import_scene
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.breaches.offences import offences_sentence
from advdiff_sumo.metrics.columns import CRITICAL_COLUMNS, OFFENCE_COLUMNS, VERDICT_COLUMNS
from advdiff_sumo.metrics.metric_rows import episode_row
from advdiff_sumo.metrics.near_miss import resolution_clause
from advdiff_sumo.metrics.summary import EpisodeMetrics, summarise
from advdiff_sumo.report.stored_record import record_of_states

COARSEST_STEP_S = 0.2
#: Columns of a judged scenario in JSON.
JSON_COLUMNS = (
    *("target_collision", "collision_time_s", "collision_partner", "collision_type", "at_fault"),
    *VERDICT_COLUMNS,
    *CRITICAL_COLUMNS,
    *OFFENCE_COLUMNS,
)
_EXPORTED = (".xosc", ".cr.xml", ".pkl", ".fcd.xml", ".csv")


@dataclass(frozen=True)
class Scenario:
    """Recorded road users, one of which is judged.

    Attributes:
        name: of the scenario.
        source: file or folder it was read from.
        tracks: (A, T) states in the net's frame.
        target: row of the judged road user.
    """

    name: str
    source: Path
    tracks: Tracks
    target: int

    @property
    def target_id(self) -> str:
        """Id of the judged road user."""
        return self.tracks.ids[self.target]


def read_scenarios(path: Path, target: str | None = None) -> Iterator[Scenario]:
    """Yield the scenarios of *path*: one of a file exported by advdiff-sumo, or the scenes of a driving log.

    Args:
        path: file, or folder of a log.
        target: id of the judged road user; None: the exported target, or the log's own vehicle.

    Raises:
        InputError: it cannot be read, its instants are too far apart, or there is no such road user.
    """
    imported = _imported(path)
    if imported is not None:
        ending = next(suffix for suffix in _EXPORTED if path.name.endswith(suffix))
        yield _scenario(path.name.removesuffix(ending), path, imported.tracks, imported.target, target)
        return
    for scene in open_log(path).scenes():
        yield _scenario(scene.name, scene.source, scene.tracks, scene.ego, target)


@dataclass(frozen=True)
class Judgement:
    """The judgement of a scenario.

    Attributes:
        metrics: of the target.
        row: the same by column of ``episodes.parquet``.
    """

    metrics: EpisodeMetrics
    row: Mapping[str, Any]

    def summary(self) -> dict[str, Any]:
        """Return the figures of ``JSON_COLUMNS``."""
        return {name: self.row[name] for name in JSON_COLUMNS}


def judge_scenario(scenario: Scenario, road: RoadMap, search: bool = False) -> Judgement:
    """Judge the target of *scenario* on *road*, without signals and routes, which scenarios lack.

    Args:
        scenario: the recorded road users.
        road: the net that they drove on.
        search: run the clairvoyant search if the target collides.

    Raises:
        FileError: the target is off the road of that net most of the time.
        WeightsError: the search has no weights.
    """
    tracks, row = scenario.tracks, scenario.target
    is_present = tracks.valid[row]
    sizes_m = np.broadcast_to(tracks.size_m[row], (int(is_present.sum()), 2))
    boxes = corners(tracks.xy_m[row, is_present], tracks.yaw_rad[row, is_present], sizes_m)
    if float(np.median(road.off_road_share(boxes))) > 0.5:
        raise FileError(
            scenario.source,
            f"'{scenario.target_id}' is off the road of {road.path} most of the time",
            "give the net of this scenario, in its frame (advdiff-sumo convert)",
        )
    present_steps = np.flatnonzero(is_present)
    window = tracks.window(int(present_steps[0]), int(present_steps[-1]) + 1)
    record = record_of_states(EpisodeStates(window, row), {}, None)
    metrics = summarise(record, road, solvable(record, road) if search else None)
    return Judgement(metrics, episode_row(record, road, metrics))


def outcome(metrics: EpisodeMetrics) -> str:
    """Return the outcome and the rules that the target broke, as text for people."""
    sentence, offences = _outcome(metrics), offences_sentence(metrics.offences)
    return f"{sentence.rstrip('.')}. {offences}" if offences else sentence


def _outcome(metrics: EpisodeMetrics) -> str:
    if metrics.struck is not None:
        verdict = metrics.struck.verdict
        discounted = "unavoidable" if verdict.unavoidable else "not counted"
        label = "valid failure" if verdict.valid_failure else discounted
        return f"{verdict.kind} at {metrics.struck.collision.time_s:.1f} s, {label}. {verdict.sentence}"
    if metrics.left_road is not None:
        return f"left the road at {metrics.left_road.time_s:.1f} s, valid failure"
    near_miss = metrics.near_miss
    if near_miss is not None and near_miss.critical:
        braking = f"a careful driver would have had to brake at {near_miss.brake_mps2:.2f} m/s²"
        return f"critical at {near_miss.time_s:.1f} s: {braking}; {resolution_clause(near_miss.resolved_by)}"
    return "no collision"


def _imported(path: Path) -> ImportedScene | None:
    """Return the scene of a file exported by advdiff-sumo; None for any other file or folder."""
    if not path.is_file() or not path.name.endswith(_EXPORTED):
        return None
    try:
        return import_scene(path)
    except FileError:
        if path.name.endswith((".cr.xml", ".pkl")):
            return None  # written by other software: read as a log
        raise


def _scenario(
    name: str, source: Path, tracks: Tracks, default_target: int, target_id: str | None
) -> Scenario:
    if tracks.dt_s > COARSEST_STEP_S:
        problem = f"has a state every {tracks.dt_s:g} s, too seldom to see collisions"
        raise FileError(source, problem, f"give one with a state every {COARSEST_STEP_S:g} s or more often")
    if target_id is not None and target_id not in tracks.index:
        raise FileError(source, f"has no road user '{target_id}'", did_you_mean(target_id, tracks.ids))
    return Scenario(name, source, tracks, default_target if target_id is None else tracks.index[target_id])
