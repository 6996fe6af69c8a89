"""CMA-ES of the package ``cmaes``, whose samples of one generation share what the covariance is made of."""

from __future__ import annotations

import cmaes
import numpy as np

from advdiff_sumo.core.arrays import FloatArray


class Evolution(cmaes.CMA):  # type: ignore[misc] # cmaes comes without types
    """CMA-ES that gives the same samples as :class:`cmaes.CMA`, each for one product with the deviations, not two.

    ``cmaes`` multiplies axes and deviations of the covariance again for every sample, and for every one that it draws
    again as it is out of bounds; they change with :meth:`tell` alone.
    """

    _axes: FloatArray | None = None

    def tell(self, solutions: list[tuple[FloatArray, float]]) -> None:
        """Learn from the values of a generation."""
        self._axes = None
        super().tell(solutions)

    def _sample_solution(self) -> FloatArray:
        if self._axes is None:
            axes, deviations = self._eigen_decomposition()
            self._axes = axes.dot(np.diag(deviations))
        drawn = self._rng.randn(self._n_dim)
        return np.asarray(self._mean + self._sigma * self._axes.dot(drawn))

    def _is_feasible(self, param: FloatArray) -> bool:
        low, high = self._bounds[:, 0], self._bounds[:, 1]
        return bool((param >= low).all() and (param <= high).all())
