"""Which revision a run records for itself."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from advdiff_sumo.sim import run_episodes
from advdiff_sumo.sim.run_episodes import git_revision


def test_the_revision_is_that_of_the_packages_own_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An environment inside another project once gave that project's revision; an installed package has none."""
    git = ("git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org")
    for words in (("init", "--quiet"), ("commit", "--quiet", "--allow-empty", "--message", "theirs")):
        subprocess.run([*git, *words], check=True, capture_output=True)
    installed = tmp_path / ".venv" / "lib" / "advdiff_sumo" / "sim" / "run_episodes.py"
    installed.parent.mkdir(parents=True)
    monkeypatch.setattr(run_episodes, "__file__", str(installed))
    assert git_revision() == ""
    monkeypatch.setattr(run_episodes, "__file__", str(tmp_path / "advdiff_sumo" / "sim" / "run_episodes.py"))
    (tmp_path / "advdiff_sumo").mkdir()
    assert len(git_revision()) == 40
