"""Starting and ending SUMO."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.errors import NetError, SimulationError, StartRefusedError
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.sim.session import Session, SessionOptions
from tests.hang_guard import HANG_S
from tests.sim.nets import EAST, Stage, stage

EASTBOUND = ("WM", "ME")


def flock(s: Stage, steps: int) -> np.ndarray:
    """Return positions and speeds (steps, vehicles, 3) of the vehicles that drive in *s* already."""
    names = sorted(s.api.vehicle.getIDList())
    out = []
    for _ in range(steps):
        s.step()
        out.append([(*s.api.vehicle.getPosition(n), s.api.vehicle.getSpeed(n)) for n in names])
    return np.array(out)


def with_traffic(s: Stage) -> None:
    for k in range(8):
        s.add(f"v{k}", EASTBOUND, lane=k % 2, at=10, speed=8 + k % 3, kind="krauss")
        for _ in range(20):
            s.step()


def test_the_command_line_is_explicit(tmp_path: Path) -> None:
    options = SessionOptions(tmp_path / "a.net.xml", 7, routes=(Path("r1"), Path("r2")), begin_s=12.5)
    words = options.arguments()
    pairs = dict(zip(words[::2], words[1::2], strict=True))
    assert pairs["--seed"] == "7"
    assert pairs["--begin"] == "12.5"
    assert pairs["--route-files"] == "r1,r2"
    assert pairs["--lateral-resolution"] == "0.4"
    assert pairs["--collision.action"] == "warn"
    assert pairs["--time-to-teleport"] == "-1"
    assert "--load-state" not in pairs
    plain = SessionOptions(tmp_path / "a.net.xml", 7, lateral_resolution_m=0.0).arguments()
    assert "--lateral-resolution" not in plain


def test_nothing_starts_before_with(tmp_path: Path) -> None:
    session = Session(SessionOptions(tmp_path / "missing.net.xml", 1))
    assert session.api is None


def test_it_steps_and_closes(street: Path) -> None:
    with Session(SessionOptions(street, 1)) as session:
        session.step()
        session.step()
        assert session.time_s == pytest.approx(0.2)
    with Session(SessionOptions(street, 1, begin_s=30.0)) as session:
        assert session.time_s == pytest.approx(30.0)


def test_one_simulation_in_a_process(street: Path) -> None:
    with Session(SessionOptions(street, 1)) as session:
        session.step()
        with (
            pytest.raises(SimulationError, match="a second SUMO simulation in one process"),
            Session(SessionOptions(street, 2)),
        ):
            pass
        session.step()  # the first one goes on
        assert session.time_s == pytest.approx(0.2)


def test_an_error_inside_closes_it(street: Path) -> None:
    with pytest.raises(RuntimeError, match="mine"), Session(SessionOptions(street, 1)):
        raise RuntimeError("mine")
    with Session(SessionOptions(street, 1)) as session:
        session.step()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "is not accessible (No such file or directory)"),
        ("", "invalid document structure"),
        ("<routes/>", "Invalid network, no network version declared"),
    ],
)
def test_a_bad_net_gives_sumos_own_sentence_and_prints_nothing(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], content: str | None, sentence: str
) -> None:
    net = tmp_path / "bad.net.xml"
    if content is not None:
        net.write_text(content)
    with (
        pytest.raises(StartRefusedError, match="SUMO does not start: ") as caught,
        Session(SessionOptions(net, 1)),
    ):
        pass
    message = str(caught.value)
    assert sentence in message
    assert "\n" not in message
    assert len(message) > len("SUMO does not start: ") + 10
    assert capfd.readouterr() == ("", "")


def test_broken_demand_gives_one_line(
    street: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    demand = tmp_path / "cut.rou.xml"
    demand.write_text('<routes><vType id="x"/><vehicle id="a" depart="0"')
    with (
        pytest.raises(SimulationError, match=r"cut\.rou\.xml") as caught,
        Session(SessionOptions(street, 1, routes=(demand,))) as session,
    ):
        session.step()
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_net_that_ends_inside_a_tag_would_kill_sumo_but_the_map_refuses_it_first(tmp_path: Path) -> None:
    net = tmp_path / "cut.net.xml"
    net.write_text("<net><edge")
    script = "import sys, libsumo; libsumo.start(['sumo', '-n', sys.argv[1], '--xml-validation', 'never'])"
    done = subprocess.run(
        [sys.executable, "-c", script, str(net)], capture_output=True, timeout=HANG_S, check=False
    )
    assert done.returncode == -signal.SIGSEGV
    with pytest.raises(NetError, match=r"cut\.net\.xml"):
        RoadMap.read(net)


def test_after_a_bad_net_a_good_one_starts(tmp_path: Path, street: Path) -> None:
    with pytest.raises(SimulationError), Session(SessionOptions(tmp_path / "none.net.xml", 1)):
        pass
    with Session(SessionOptions(street, 1)) as session:
        session.step()


def test_ordinary_running_prints_nothing(street: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with stage(street) as s:
        s.add("a", EASTBOUND)
        s.add("b", EASTBOUND, at=60)
        s.hold("a", 100, -4.8, EAST)
        s.hold("b", 102, -4.8, EAST)
        for _ in range(3):
            s.step()
        assert s.reported()
    assert capfd.readouterr() == ("", "")


def test_the_same_seed_gives_the_same_traffic(street: Path) -> None:
    runs = []
    for _ in range(2):
        with stage(street) as s:
            with_traffic(s)
            runs.append(flock(s, 50))
    assert (runs[0] == runs[1]).all()


def test_a_saved_state_goes_on_as_if_nothing_had_been(street: Path, tmp_path: Path) -> None:
    state = tmp_path / "state.xml"
    with stage(street) as s:
        with_traffic(s)
        s.api.simulation.saveState(str(state))
        expected = flock(s, 50)
        time = s.session.time_s
    with stage(street, otherwise={"--load-state": state, "--begin": f"{time - 5.0:g}"}) as s:
        got = flock(s, 50)
        assert s.session.time_s == pytest.approx(time)
    assert expected.shape == got.shape
    assert expected.shape[1] > 3
    np.testing.assert_allclose(got, expected, atol=1e-6)
