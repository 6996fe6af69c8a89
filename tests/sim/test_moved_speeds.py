"""Which speed of a moved vehicle others see, and what is restored at its release (docs/sumo.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from advdiff_sumo.core.record import Controller
from tests.sim.actuated import EASTBOUND, actuator_on, move
from tests.sim.nets import EAST, stage


def test_the_speed_that_others_see_is_clipped_and_a_speed_factor_cures_it(street: Path) -> None:
    def seen(factor: float | None) -> float:
        with stage(street) as s:
            s.add("b", EASTBOUND)
            s.free("b")
            if factor is not None:
                s.api.vehicle.setSpeedFactor("b", factor)
            for k in range(20):
                s.put("b", np.array((30.0 + 2.5 * k, -4.8)), EAST)
                s.session.step()
            return float(s.api.vehicle.getSpeed("b"))

    assert seen(None) == pytest.approx(14.0, abs=0.01), "the lane's limit, not the 25 m/s it drives"
    assert seen(20.0) == pytest.approx(25.0, abs=0.01)


def test_a_new_maximum_speed_resets_the_speed_factor(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        s.api.vehicle.setSpeedFactor("b", 20.0)
        s.api.vehicle.setMaxSpeed("b", 90.0)
        assert s.api.vehicle.getSpeedFactor("b") == 1.0


def test_the_actuator_lets_others_see_the_true_speed_and_restores_the_limits(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        s.api.vehicle.setSpeedFactor("b", 0.9)
        before = s.api.vehicle.getSpeedFactor("b"), s.api.vehicle.getMaxSpeed("b")
        actuator = actuator_on(s, street)
        actuator.take(0)
        for k in range(20):
            move(actuator, s, 0, (30.0 + 2.5 * k, -4.8), EAST, 25.0)
        assert s.api.vehicle.getSpeed("b") == pytest.approx(25.0, abs=0.01)
        actuator.release(0)
        assert (s.api.vehicle.getSpeedFactor("b"), s.api.vehicle.getMaxSpeed("b")) == before
        assert s.api.vehicle.getSpeedMode("b") == 31
        assert s.api.vehicle.getLaneChangeMode("b") == 1621


def test_others_see_the_mean_speed_of_the_last_step(street: Path) -> None:
    """Braking at 8 m/s² from 12 m/s covers 1.16 m in 0.1 s; the speed is then 11.2 m/s."""
    with stage(street) as s:
        s.add("b", EASTBOUND)
        actuator = actuator_on(s, street)
        actuator.take(0)
        for x in (30.0, 31.2, 32.36):
            move(actuator, s, 0, (x, -4.8), EAST, 11.2 if x == 32.36 else 12.0)
        assert s.api.vehicle.getSpeed("b") == pytest.approx(11.6)
        assert actuator.world.speed_mps[0] == 11.2
        assert s.pose("b")[0] == pytest.approx((32.36, -4.8))


def test_a_vehicle_with_a_stop_ahead_shows_others_the_speed_of_sumos_own_driver(street: Path) -> None:
    """It is held in place, while SUMO's driver would have started."""
    with stage(street) as s:
        s.add("b", EASTBOUND)
        s.api.vehicle.setStop("b", "ME", 50.0, duration=20.0)
        (x, y), yaw = s.pose("b")
        s.hold("b", x, y, yaw)
        for _ in range(30):
            s.step()
        assert s.api.vehicle.getSpeed("b") > 5.0


@pytest.mark.parametrize("begins_at_a_stop", [False, True])
def test_the_actuator_sets_stops_aside_and_gives_back_those_that_lie_ahead(
    street: Path, begins_at_a_stop: bool
) -> None:
    with stage(street) as s:
        vehicle = s.api.vehicle
        s.add("b", EASTBOUND, at=60.0)
        if begins_at_a_stop:
            vehicle.setStop("b", "WM", 62.0, duration=1000.0)
            for _ in range(60):
                s.session.step()
            assert vehicle.isStopped("b")
        vehicle.setStop("b", "WM", 100.0, duration=5.0)
        vehicle.setStop("b", "ME", 40.0, duration=5.0)
        actuator = actuator_on(s, street)
        x, y = actuator.world.xy_m[0].tolist()
        actuator.take(0)
        assert not vehicle.getStops("b")
        for _ in range(10):
            move(actuator, s, 0, (x, y), EAST)
        assert vehicle.getSpeed("b") == 0.0
        for k in range(1, 31):
            move(actuator, s, 0, (x + 2.0 * k, y), EAST, 20.0)  # past the second stop
        actuator.release(0, EASTBOUND)
        assert [(stop.lane, stop.endPos) for stop in vehicle.getStops("b")] == [("ME_0", 40.0)]
        for _ in range(400):
            s.session.step()
            if vehicle.isStopped("b"):
                break
        assert vehicle.isStopped("b")
        assert vehicle.getLaneID("b") == "ME_0"


def test_a_parked_vehicle_stays_parked(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND, at=60.0)
        s.api.vehicle.setStop("b", "WM", 90.0, duration=99.0, flags=1)
        for _ in range(100):
            s.session.step()
        actuator = actuator_on(s, street)
        actuator.take(0)
        assert s.api.vehicle.isStoppedParking("b")
        actuator.release(0, EASTBOUND)
        s.session.step()
        assert s.api.vehicle.isStoppedParking("b")


def test_sumo_shows_reverse_motion_as_forward_and_sideways_motion_as_none(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        for k in range(10):
            s.hold("b", 100.0 - 0.3 * k, -4.8, EAST)
            s.step()
        backwards = s.api.vehicle.getSpeed("b")
        for k in range(10):
            s.hold("b", 97.3, -4.8 + 0.1 * k, EAST)
            s.step()
        sideways = s.api.vehicle.getSpeed("b")
    assert backwards == pytest.approx(3.0, abs=0.01)
    assert sideways == pytest.approx(0.0, abs=0.01)


def test_our_own_states_win_over_sumos(street: Path) -> None:
    with stage(street) as s:
        s.add("b", EASTBOUND)
        actuator = actuator_on(s, street)
        actuator.take(0)
        for k in range(5):
            move(actuator, s, 0, (100.0 - 0.3 * k, -4.8), EAST, -3.0)
        world = actuator.world
        assert world.speed_mps[0] == -3.0
        assert world.controller[0] == Controller.POLICY
        assert world.lane[0] == "WM_0"
