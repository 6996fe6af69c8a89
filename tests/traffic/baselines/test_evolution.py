"""Our CMA-ES draws what the package's own draws."""

from __future__ import annotations

import cmaes
import numpy as np
import pytest

from advdiff_sumo.traffic.baselines.evolution import Evolution


@pytest.mark.parametrize("size", [3, 32])
def test_its_samples_are_those_of_the_package(size: int) -> None:
    bounds = np.tile([-1.0, 1.0], (size, 1))
    given = {"mean": np.full(size, 0.4), "sigma": 0.4, "bounds": bounds, "seed": 5, "population_size": 8}
    ours, theirs = Evolution(**given), cmaes.CMA(**given)
    for _ in range(6):
        drawn = [optimiser.ask() for optimiser in (ours, theirs) for _ in range(8)]
        assert np.array(drawn[:8]).tobytes() == np.array(drawn[8:]).tobytes()
        values = [float((x**2).sum()) for x in drawn[:8]]
        for optimiser in (ours, theirs):
            optimiser.tell(list(zip(drawn[:8], values, strict=True)))
