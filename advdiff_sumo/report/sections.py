"""Makes each episode's part of the page: its picture and its data for the player."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.metrics.reference import ReferenceDrive
from advdiff_sumo.metrics.severity import badge, is_failure, is_valid_failure
from advdiff_sumo.report.blocks import deviating_tracks, episode_block
from advdiff_sumo.report.careful_driver import drive_of, tracks_of
from advdiff_sumo.report.charts import Chart, charts_of
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.labels import Labels
from advdiff_sumo.report.margin_table import read_command
from advdiff_sumo.report.nets import NetLayers
from advdiff_sumo.report.reference_episodes import ReferenceEpisodes
from advdiff_sumo.report.scene_picture import picture_of
from advdiff_sumo.report.select import attacker_of, nearest_s, pictured_episodes
from advdiff_sumo.report.series import Series, series_of
from advdiff_sumo.report.svg import svg_picture
from advdiff_sumo.report.templates import (
    further_offences,
    near_miss_sentence,
    number,
    templates,
    title,
    words,
)
from advdiff_sumo.traffic.manoeuvres.intensity import SEVERITY_KINDS

#: Pictures beyond this number of bytes are left out, the least severe episodes first.
PICTURE_BYTES = 6_000_000
#: The same for the player's episodes; streets are extra.
PLAYED_BYTES = 18_000_000


@dataclass(frozen=True)
class Section:
    """One episode's part of the page.

    Attributes:
        episode: its number.
        net: name of its net.
        html: its picture and facts; "" without picture.
        block: its states for the player; "" if there are none or the player is full.
        facts: texts and figures for the player.
        target_xy_m: (T, 2) path of the target.
        left_out: whether its picture was left out because of the limit of size.
    """

    episode: int
    net: str
    html: str = ""
    block: str = ""
    facts: dict[str, Any] = field(default_factory=dict)
    target_xy_m: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    left_out: bool = False


class _Budget:
    """A limit of bytes; the first text always fits."""

    def __init__(self, limit: int) -> None:
        self.limit, self.used, self.full = limit, 0, False

    def accepts(self, text: str) -> bool:
        """Return whether *text* fits, and count its bytes; after the first text that does not fit, none fits."""
        size = len(text.encode())
        self.full = self.full or (self.used > 0 and self.used + size > self.limit)
        self.used += 0 if self.full else size
        return not self.full


class Sections:
    """Makes the sections of one page.

    Args:
        run: the run.
        nets: layers of its nets.
        naturals: natural counterparts of its episodes.
        labels: of targets and backgrounds.
        places: names of the nets in the order of their numbers on the page.
    """

    def __init__(
        self,
        run: FinishedRun,
        nets: NetLayers,
        naturals: ReferenceEpisodes,
        labels: Labels,
        places: Sequence[str],
    ) -> None:
        self._run, self._nets, self._naturals = run, nets, naturals
        self._labels, self._places = labels, places
        self._template = templates().get_template("episode.html")
        self._pictures, self._played = _Budget(PICTURE_BYTES), _Budget(PLAYED_BYTES)
        self._is_margin = bool(read_command(run.folder))

    def make(self, ordered: Sequence[Row]) -> Iterator[Section]:
        """Yield the sections of *ordered* episodes, worst first; empty ones once the limits are reached."""
        pictured = {int(row["episode"]) for row in pictured_episodes(ordered)}
        for row in ordered:
            gets_picture = int(row["episode"]) in pictured
            if self._played.full and (self._pictures.full or not gets_picture):
                yield Section(int(row["episode"]), str(row["net"]), left_out=gets_picture)
            else:
                yield self._section(row, gets_picture)

    def _section(self, row: Row, gets_picture: bool) -> Section:
        episode, net = int(row["episode"]), str(row["net"])
        states, contacts = self._run.states(episode), self._run.collisions_of(episode)
        if states is None:
            html = self._template.render(
                row=row,
                picture=None,
                contacts=contacts,
                labels=self._labels,
                tail=self._run.log_tails.get(episode),
            )
            fits = gets_picture and self._pictures.accepts(html)
            return Section(episode, net, html if fits else "", left_out=gets_picture and not fits)
        attacker = attacker_of(row)
        layer = self._nets.layer(net)
        drive = None if layer is None else drive_of(self._run, row, states, layer.road)
        series = series_of(states, attacker, drive)
        charts = charts_of(series, row["collision_time_s"])
        html = self._html(row, states, charts, contacts) if gets_picture and not self._pictures.full else ""
        fits = bool(html) and self._pictures.accepts(html)
        block = "" if self._played.full else self._block(row, states, attacker, series, drive)
        return Section(
            episode=episode,
            net=net,
            html=html if fits else "",
            block=block if block and self._played.accepts(block) else "",
            facts=self._facts(row, charts, contacts),
            target_xy_m=states.tracks.xy_m[states.target],
            left_out=gets_picture and not fits,
        )

    def _block(
        self,
        row: Row,
        states: EpisodeStates,
        attacker: str | None,
        series: Series,
        drive: ReferenceDrive | None,
    ) -> str:
        plans = self._run.plans(int(row["episode"]))
        careful_tracks = None if drive is None else tracks_of(drive, states)
        return episode_block(
            states, attacker, series, self._natural_tracks(row, states), plans, careful_tracks
        )

    def _natural_tracks(self, row: Row, states: EpisodeStates) -> Tracks | None:
        natural = self._naturals.natural_tracks(row)
        return None if natural is None else deviating_tracks(states, natural)

    def _html(self, row: Row, states: EpisodeStates, charts: Sequence[Chart], contacts: Sequence[Row]) -> str:
        picture = picture_of(states, row, contacts, self._nets.layer(str(row["net"])))
        return self._template.render(
            row=row,
            picture=picture,
            svg=svg_picture(picture),
            charts=charts,
            contacts=contacts,
            target_id=states.tracks.ids[states.target],
            labels=self._labels,
            tail=self._run.log_tails.get(int(row["episode"])),
        )

    def _facts(self, row: Row, charts: Sequence[Chart], contacts: Sequence[Row]) -> dict[str, Any]:
        net = str(row["net"])
        episode = f"{row['key']} --sweep ." if row["key"] else f"{row['episode']} --run ."
        attack = (
            row.get("attacker_manoeuvre") or row["attack_kind"]
        )  # of a run, only what was asked for is known
        has_margin = is_valid_failure(row) and attack in SEVERITY_KINDS
        description = (
            f"{self._labels.target(row)} in {self._labels.background(row)} traffic, seed scene {row['scene']}"
        )
        return {
            **facts_of(row, charts, contacts),
            "line": description,
            "command": f"advdiff-sumo replay {episode}",
            "margin": f"advdiff-sumo margin {episode}" if has_margin and not self._is_margin else "",
            "net": -1 if self._nets.layer(net) is None else self._places.index(net),
        }


def facts_of(row: Row, charts: Sequence[Chart], contacts: Sequence[Row]) -> dict[str, Any]:
    """Return the texts and figures of one episode for the player, as plain values."""
    has_collided = bool(row["target_collision"])
    contact = row["collision_time_s"] if has_collided else None
    moment = contact if contact is not None else nearest_s(row)
    background_collisions = [c for c in contacts if not c["with_target"] and not c["initial"]]
    return {
        "number": int(row["episode"]),
        "title": f"Episode {row['episode']}: {title(row)}",
        "badge": badge(row),
        "verdict": _verdict(row),
        "fault": str(row["at_fault"] or "") if has_collided else "",
        "hit": bool(row["collision_partner"]),
        "contact": contact,
        "moment": 0.0 if moment is None else float(moment),
        "momentName": "Contact" if has_collided else "Nearest",
        "impact": [row["impact_x_m"], row["impact_y_m"]]
        if has_collided and row["impact_x_m"] is not None
        else None,
        "others": [[c["impact_x_m"], c["impact_y_m"], c["time_s"]] for c in background_collisions],
        "charts": {chart.title.rpartition(" (")[0]: chart.summary for chart in charts},
    }


def _verdict(row: Row) -> str:
    """Return the outcome of an episode, and the rules that the target broke apart from its collision."""
    return " ".join(f"{_outcome(row)} {further_offences(row)}".split())


def _outcome(row: Row) -> str:
    failed = str(row["failure_message"] or "No reason was recorded.") if is_failure(row) else ""
    if failed and not row["target_collision"]:
        return failed
    if row["critical"]:
        return near_miss_sentence(row)
    if not row["target_collision"]:
        gap = number(row["min_clearance_m"], 2, "m")
        return f"No collision; the least gap was {gap}."
    visible = row["attacker_visible"]
    perception = (
        ""
        if visible is None
        else f" The target {'had' if visible else 'had not'} perceived the other vehicle."
    )
    sentence, reason = str(row["verdict"] or ""), str(row["fault_reason"] or "")
    reason = "" if reason.rstrip(".").lower() in sentence.lower() else reason
    return " ".join(f"{sentence} At fault: {words(row['at_fault'])}. {reason}{perception} {failed}".split())
