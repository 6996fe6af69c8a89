"""Collisions of background vehicles among themselves, and SUMO's own collision list beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from advdiff_sumo.core.record import Controller, EpisodeRecord
from advdiff_sumo.metrics.collision import Collision, Touches, both_walk, find_touches, overlapping_steps


@dataclass(frozen=True)
class SumoComparison:
    """SUMO's list against the boxes, counted in (instant, pair).

    Attributes:
        listed: entries of SUMO's list, a pair at an instant counted once.
        sumo_only: listed by SUMO while the boxes neither overlap nor did in the step before.
        ours_only: overlaps that SUMO did not list.
    """

    listed: int
    sumo_only: int
    ours_only: int


def background_collisions(record: EpisodeRecord, contacts: Sequence[Collision]) -> list[Collision]:
    """Return those of *contacts* without the target that were not there from the beginning, replayed pairs left out."""
    return [c for c in _among_background(record, contacts) if not both_replayed(record, c)]


def replayed_collisions(record: EpisodeRecord, contacts: Sequence[Collision]) -> list[Collision]:
    """Return those of *contacts* of two road users that both follow their log: the log's, not ours."""
    return [c for c in _among_background(record, contacts) if both_replayed(record, c)]


def both_replayed(record: EpisodeRecord, collision: Collision) -> bool:
    """Return whether both of *collision* follow their log at the instant before the contact."""
    return bool((record.controller[list(collision.rows), collision.step] == Controller.REPLAYED).all())


def _among_background(record: EpisodeRecord, contacts: Sequence[Collision]) -> list[Collision]:
    return [c for c in contacts if record.target not in c.rows and not c.initial]


def compare_with_sumo(record: EpisodeRecord, touches: Touches | None = None) -> SumoComparison:
    """Return how far SUMO's own collision list agrees with the boxes.

    SUMO misses and invents collisions (its check follows lanes); a vehicle outside the record counts as a
    disagreement, since no box of ours can confirm it. *touches* saves the search where it was made.
    """
    touches = touches if touches is not None else find_touches(record.tracks)
    ids = record.tracks.ids
    ours = {
        (k, *sorted((ids[i], ids[j])))
        for k, i, j in overlapping_steps(touches)
        if not both_walk(record, i, j, k)
    }
    listed = {(c.step, *sorted((c.collider, c.victim))) for c in record.sumo_collisions}
    return SumoComparison(len(listed), len(listed - ours), len(ours - listed))
