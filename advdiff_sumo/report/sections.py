"""Each episode's part of the page: its picture, and what the player needs of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.metrics.near_miss import resolved
from advdiff_sumo.metrics.reference import ReferenceDrive
from advdiff_sumo.metrics.severity import badge, is_failure
from advdiff_sumo.report.blocks import departed, episode_block
from advdiff_sumo.report.careful_driver import drive_of, tracks_of
from advdiff_sumo.report.charts import Chart, charts_of
from advdiff_sumo.report.folder import FinishedRun, Row
from advdiff_sumo.report.labels import Labels
from advdiff_sumo.report.nets import NetLayers
from advdiff_sumo.report.reference_episodes import ReferenceEpisodes
from advdiff_sumo.report.scene_picture import picture_of
from advdiff_sumo.report.select import attacker_of, pictured
from advdiff_sumo.report.series import Series, series_of
from advdiff_sumo.report.svg import svg_picture
from advdiff_sumo.report.templates import further_offences, number, templates, title, words

#: Pictures beyond this many bytes are left out, the least severe episodes first.
PICTURE_BYTES = 6_000_000
#: The same for what the player shows; streets come on top.
PLAYED_BYTES = 18_000_000


@dataclass(frozen=True)
class Section:
    """One episode's part of the page.

    Attributes:
        episode: its number.
        net: name of its net.
        html: its picture and facts; "" where it gets none.
        block: its states for the player; "" where there are none or no room.
        facts: what the player says about it.
        target_xy_m: (T, 2) where the target drove.
        left_out: its picture was left out for want of room.
    """

    episode: int
    net: str
    html: str = ""
    block: str = ""
    facts: dict[str, Any] = field(default_factory=dict)
    target_xy_m: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    left_out: bool = False


class _Budget:
    """Bytes that may still be used; the first piece always fits."""

    def __init__(self, most: int) -> None:
        self.most, self.used, self.full = most, 0, False

    def takes(self, text: str) -> bool:
        """Return whether *text* fits, and count it; after the first that does not, nothing fits."""
        size = len(text.encode())
        self.full = self.full or (self.used > 0 and self.used + size > self.most)
        self.used += 0 if self.full else size
        return not self.full


class Sections:
    """Makes the sections of one page.

    Args:
        run: the run.
        nets: for the streets.
        naturals: for what happened without attack.
        labels: names of targets and backgrounds.
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

    def of(self, ordered: Sequence[Row]) -> Iterator[Section]:
        """Yield the sections of *ordered* episodes, worst first; empty ones where there is no more room."""
        drawn = {int(row["episode"]) for row in pictured(ordered)}
        for row in ordered:
            wanted = int(row["episode"]) in drawn
            if self._played.full and (self._pictures.full or not wanted):
                yield Section(int(row["episode"]), str(row["net"]), left_out=wanted)
            else:
                yield self._section(row, wanted)

    def _section(self, row: Row, wanted: bool) -> Section:
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
            fits = wanted and self._pictures.takes(html)
            return Section(episode, net, html if fits else "", left_out=wanted and not fits)
        attacker = attacker_of(row)
        layer = self._nets.layer(net)
        drive = None if layer is None else drive_of(self._run, row, states, layer.road)
        series = series_of(states, attacker, drive)
        charts = charts_of(series, row["collision_time_s"])
        html = self._html(row, states, charts, contacts) if wanted and not self._pictures.full else ""
        fits = bool(html) and self._pictures.takes(html)
        block = "" if self._played.full else self._block(row, states, attacker, series, drive)
        return Section(
            episode=episode,
            net=net,
            html=html if fits else "",
            block=block if block and self._played.takes(block) else "",
            facts=self._facts(row, charts, contacts),
            target_xy_m=states.tracks.xy_m[states.target],
            left_out=wanted and not fits,
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
        careful = None if drive is None else tracks_of(drive, states)
        return episode_block(states, attacker, series, self._ghosts(row, states), plans, careful)

    def _ghosts(self, row: Row, states: EpisodeStates) -> Tracks | None:
        natural = self._naturals.of(row)
        return None if natural is None else departed(states, natural)

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
        net, key = str(row["net"]), str(row["key"])
        where = (
            f"{self._labels.target(row)} in {self._labels.background(row)} traffic, seed scene {row['scene']}"
        )
        return {
            **facts_of(row, charts, contacts),
            "line": where,
            "command": f"advdiff-sumo replay {key} --sweep ."
            if key
            else f"advdiff-sumo replay {row['episode']} --run .",
            "net": -1 if self._nets.layer(net) is None else self._places.index(net),
        }


def facts_of(row: Row, charts: Sequence[Chart], contacts: Sequence[Row]) -> dict[str, Any]:
    """Return what the player says about one episode, as plain values."""
    hit = bool(row["target_collision"])
    contact = row["collision_time_s"] if hit else None
    moment = contact if contact is not None else row["min_clearance_time_s"]
    others = [c for c in contacts if not c["with_target"] and not c["initial"]]
    return {
        "number": int(row["episode"]),
        "title": f"Episode {row['episode']}: {title(row)}",
        "badge": badge(row),
        "verdict": _verdict(row),
        "fault": str(row["at_fault"] or "") if hit else "",
        "hit": bool(row["collision_partner"]),
        "contact": contact,
        "moment": 0.0 if moment is None else float(moment),
        "momentName": "Contact" if hit else "Nearest",
        "impact": [row["impact_x_m"], row["impact_y_m"]] if hit and row["impact_x_m"] is not None else None,
        "others": [[c["impact_x_m"], c["impact_y_m"], c["time_s"]] for c in others],
        "charts": {chart.title.rpartition(" (")[0]: chart.summary for chart in charts},
    }


def _verdict(row: Row) -> str:
    """Return what came of it, and which rules the target broke of itself."""
    return " ".join(f"{_outcome(row)} {further_offences(row)}".split())


def _outcome(row: Row) -> str:
    failed = str(row["failure_message"] or "No reason was recorded.") if is_failure(row) else ""
    if failed and not row["target_collision"]:
        return failed
    if row["critical"]:
        brake = number(row["critical_brake_mps2"], 1, "m/s²")
        return f"A careful driver would have had to brake at {brake}; {resolved(row['resolved_by'])}."
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
