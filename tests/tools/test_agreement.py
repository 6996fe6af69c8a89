"""Agreement of two judges, against values worked by hand."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from reference_src.agreement import cohens_kappa


def answers(both: int, first: int, second: int, neither: int) -> tuple[np.ndarray, np.ndarray]:
    """Return two judges' answers; the arguments are the numbers of questions to which they say yes."""
    answers_1 = np.repeat([True, True, False, False], [both, first, second, neither])
    answers_2 = np.repeat([True, False, True, False], [both, first, second, neither])
    return answers_1, answers_2


def test_kappa_by_hand() -> None:
    """The agreement is 0.7, that by chance 0.5, so kappa is 0.2 / 0.5; the variance is 0.2016 / 12.5."""
    kappa, low, high = cohens_kappa(*answers(20, 5, 10, 15))
    assert kappa == pytest.approx(0.4)
    assert (low, high) == (pytest.approx(0.4 - 1.96 * 0.126996, abs=1e-4), pytest.approx(0.648905, abs=1e-4))


def test_extreme_values_of_kappa() -> None:
    assert cohens_kappa(*answers(5, 0, 0, 5)) == pytest.approx((1.0, 1.0, 1.0))
    assert cohens_kappa(*answers(0, 5, 5, 0))[0] == pytest.approx(-1.0)
    with pytest.raises(ValueError, match="always give the same"):
        cohens_kappa(*answers(4, 0, 0, 0))
    with pytest.raises(ValueError, match="no answers"):
        cohens_kappa(*answers(0, 0, 0, 0))
