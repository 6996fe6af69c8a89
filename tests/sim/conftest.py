"""The tiny nets, made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.sim import nets


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of :func:`nets.street`."""
    return nets.street(tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="session")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of :func:`nets.crossing` with a priority road."""
    return nets.crossing(tmp_path_factory.mktemp("crossing"))


@pytest.fixture(scope="session")
def unregulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of :func:`nets.crossing` without any rule."""
    return nets.crossing(tmp_path_factory.mktemp("unregulated"), "unregulated")


@pytest.fixture(scope="session")
def bend(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The net of :func:`nets.bend`."""
    return nets.bend(tmp_path_factory.mktemp("bend"))
