"""The doctor finds that this installation is usable, and finds faults that tests put into it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from advdiff_sumo.cli import checks
from advdiff_sumo.cli.checks import CheckState
from tests.e2e.commands import Outcome, advdiff, everything


def test_this_installation_drives(tmp_path: Path) -> None:
    done = advdiff("doctor", cwd=tmp_path)
    assert (done.code, done.err) == (0, "")
    assert done.out.splitlines()[-1] == "ready to run"
    assert "5.0 s driven among" in " ".join(done.out.split())
    for word in ("libsumo", "netconvert", "GPU", "weights", "data", "downtown-left"):
        assert word in done.out
    assert everything(tmp_path) == {}


def test_a_problem_is_printed_with_its_remedy(
    here: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ADVDIFF_DATA", "/no/such/folder")
    done = here("doctor", "--quick")
    assert done.code == 1
    assert "data: correct it or unset it" in done.out
    assert done.out.splitlines()[-1] == "1 problem to mend"
    assert "self-test" not in done.out


def states(check: Callable[[], object]) -> dict[str, tuple[CheckState, str, str]]:
    """Return topic → (state, text, hint) of the findings of a check."""
    return {finding.topic: (finding.state, finding.text, finding.hint) for finding in check()}  # type: ignore[attr-defined]


def test_a_missing_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "PACKAGES", ("numpy", "no-such-package"))
    state, text, hint = states(checks.python)["libraries"]
    assert (state, text) == (CheckState.PROBLEM, "no-such-package not installed")
    assert "pip install" in hint


def test_packages_of_sumo_in_several_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "_version", {"eclipse-sumo": "1", "libsumo": "2", "sumolib": "2"}.get)
    monkeypatch.setattr(checks, "NEEDED_BINARIES", ())
    monkeypatch.setattr(checks, "OPTIONAL_BINARIES", ())
    assert states(checks.sumo)["SUMO"][::2] == (CheckState.PROBLEM, "install all three in one version")


def test_programs_that_do_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "NEEDED_BINARIES", ("no-such-program",))
    monkeypatch.setattr(checks, "OPTIONAL_BINARIES", ("no-such-gui",))
    found = states(checks.sumo)
    assert found["no-such-program"][0] is CheckState.PROBLEM
    assert found["no-such-gui"][0] is CheckState.NOTE
    assert "does not start" in found["no-such-gui"][1]


def test_machine_code_for_another_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.backends.cpu.get_cpu_capability", lambda: "DEFAULT")
    (found,) = checks.loops()
    assert found.state is checks.CheckState.NOTE
    assert "two to three times as long" in found.hint


def test_data_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ADVDIFF_DATA", str(tmp_path))
    assert states(checks.data)["data"][0] is CheckState.NOTE
    (tmp_path / "mini" / "v1.0-mini").mkdir(parents=True)
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / "sd_a.pkl").touch()
    state, text, _ = states(checks.data)["data"]
    assert (state, text) == (CheckState.OK, f"nuScenes tables in {tmp_path / 'mini'}, 1 ScenarioNet records")


def test_a_self_test_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    state, text, _ = states(checks.self_test)["self-test"]
    assert (state, text) == (CheckState.PROBLEM, "exit code 1: nothing was said")


def test_every_finding_that_is_not_ok_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ADVDIFF_DATA", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(checks, "EXTRAS", {"odd": ("no-such-package",)})
    found = [f for check in checks.CHECKS if check is not checks.self_test for f in check()]
    wanting = [f for f in found if f.state is not CheckState.OK]
    assert {"display", "data", "extra odd"} <= {f.topic for f in wanting}
    assert all(f.hint for f in wanting)
