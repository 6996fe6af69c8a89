"""Draw random trips over a net, for the driving test."""

from __future__ import annotations

import itertools
import random
from pathlib import Path

import sumolib

from advdiff_sumo.core.errors import NetError
from advdiff_sumo.maps.read_net import BEYOND_TYPE, ids_beyond, read_root

# Lengths that all trips should exceed; the first for which the net has trips is used.
SHORTEST_TRIPS_M = (200.0, 100.0, 50.0)
# Of edges where trips begin and end; SUMO inserts overlapping cars on edges shorter than a car.
SHORTEST_END_M = 20.0
MAX_ATTEMPTS, MAX_ROUTES = 2000, 400  # of the search for a pool of routes


class RandomTrips:
    """Random trips between edges, long ones if the net has any.

    Attributes:
        beyond: edges beyond the rim of a map; trips may pass them, but do not begin or end there.
    """

    def __init__(self, net: Path, seed: int) -> None:
        """Read *net* and find its trips.

        Raises:
            NetError: there is no trip of sufficient length.
        """
        self._net = sumolib.net.readNet(str(net))
        self._random = random.Random(seed)  # noqa: S311 - traffic, not secrets
        edges = [edge for edge in self._net.getEdges() if edge.allows("passenger")]
        self._edges = sorted(edges, key=lambda edge: edge.getID())
        on_map = [edge for edge in self._edges if edge.getType() != BEYOND_TYPE]
        self._ends = [edge for edge in on_map if edge.getLength() >= SHORTEST_END_M]
        self._pool = self._find_pool(net)
        self.beyond = ids_beyond(read_root(net, "net", "a SUMO net"))

    @property
    def lane_km(self) -> float:
        """Length of all lanes for cars in km, without those in junctions."""
        lanes = [lane for edge in self._edges for lane in edge.getLanes() if lane.allows("passenger")]
        return float(sum(lane.getLength() for lane in lanes)) / 1000.0

    def _find_pool(self, net: Path) -> list[tuple[list[str], float]]:
        """Return routes to draw from; a few hundred are enough for an hour."""
        for shortest_m in SHORTEST_TRIPS_M:
            routes = (self._route(shortest_m) for _ in range(MAX_ATTEMPTS))
            pool = list(itertools.islice((route for route in routes if route is not None), MAX_ROUTES))
            if pool:
                return pool
        raise NetError(
            net, f"holds no way of {SHORTEST_TRIPS_M[-1]:.0f} m", "give a net with roads that join"
        )

    def _route(self, shortest_m: float) -> tuple[list[str], float] | None:
        """Return edges and length in m of the shortest route between two random ends; None if it is too short."""
        if not self._ends:
            return None
        origin, target = self._random.choice(self._ends), self._random.choice(self._ends)
        edges, length_m = self._net.getShortestPath(origin, target, vClass="passenger")
        if edges is None or length_m < shortest_m:
            return None
        return [edge.getID() for edge in edges], float(length_m)

    def draw(self) -> list[str]:
        """Return the edges of the next trip."""
        return self._random.choice(self._pool)[0]
