"""Collisions among background vehicles, and a comparison with SUMO's own collision list."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from advdiff_sumo.core.record import Controller, EpisodeRecord
from advdiff_sumo.metrics.collision import Collision, Touches, both_walk, find_touches, overlapping_steps


@dataclass(frozen=True)
class SumoComparison:
    """SUMO's collision list compared with overlaps of the boxes, counted in (instant, pair).

    Attributes:
        listed: entries of SUMO's list; a pair counts once per instant.
        sumo_only: entries whose boxes neither overlap nor did so in the step before.
        ours_only: overlaps that SUMO did not list.
    """

    listed: int
    sumo_only: int
    ours_only: int


def background_collisions(record: EpisodeRecord, contacts: Sequence[Collision]) -> list[Collision]:
    """Return those of *contacts* without the target that are neither ``initial`` nor of replayed pairs."""
    return [c for c in _among_background(record, contacts) if not both_replayed(record, c)]


def replayed_collisions(record: EpisodeRecord, contacts: Sequence[Collision]) -> list[Collision]:
    """Return those of *contacts* in which both road users follow their log: collisions of the log itself."""
    return [c for c in _among_background(record, contacts) if both_replayed(record, c)]


def both_replayed(record: EpisodeRecord, collision: Collision) -> bool:
    """Return whether both road users in *collision* follow their log at the instant before the contact."""
    return bool((record.controller[list(collision.rows), collision.step] == Controller.REPLAYED).all())


def _among_background(record: EpisodeRecord, contacts: Sequence[Collision]) -> list[Collision]:
    return [c for c in contacts if record.target not in c.rows and not c.initial]


def compare_with_sumo(record: EpisodeRecord, touches: Touches | None = None) -> SumoComparison:
    """Return how far SUMO's own collision list agrees with the boxes.

    SUMO misses collisions and lists false ones, as its check follows lanes. An entry with a vehicle outside the record
    counts as a disagreement, since there is no box to confirm it. Pass *touches* if they have been found already.
    """
    touches = touches if touches is not None else find_touches(record.tracks)
    ids = record.tracks.ids
    contacts = {
        (k, *sorted((ids[i], ids[j])))
        for k, i, j in overlapping_steps(touches)
        if not both_walk(record, i, j, k)
    }
    listed = {(c.step, *sorted((c.collider, c.victim))) for c in record.sumo_collisions}
    return SumoComparison(len(listed), len(listed - contacts), len(contacts - listed))
