"""The four models of UN R157 in hand-worked situations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from advdiff_sumo.metrics.reference.driver_models import (
    FSM,
    FULL_BRAKE_MPS2,
    HUMAN,
    MODELS,
    REGULATION,
    RSS,
    Situation,
    critical_metric,
    following_gap_m,
    proactive_metric,
    rss_distance_m,
    rss_lateral_m,
)
from advdiff_sumo.metrics.reference.reaction import Reaction, react


def facing(v=20.0, u=10.0, d=20.0, y=-1.9, w=0.0, a=0.0) -> Situation:
    return Situation(*(np.asarray(float(x)) for x in (v, a, u, d, y, w, 8.6)))


def test_the_human_driver_brakes_for_a_lateral_overlap() -> None:
    assert HUMAN.demand(facing(y=0.0)) == FULL_BRAKE_MPS2 == pytest.approx(7.593, abs=1e-3)
    assert HUMAN.demand(facing(y=0.01)) == 0.0
    assert HUMAN.demand(facing(d=-4.4)) == 0.0  # the ego's centre is 0.1 m past the other's


def test_the_regulation_looks_at_the_time_to_collision() -> None:
    # v − u = 10 m/s: 10 / 12 + 0.45 = 1.283 s, so 12.83 m
    assert REGULATION.demand(facing(d=12.8, y=0.5)) == 6.0
    assert REGULATION.demand(facing(d=12.9, y=0.5)) == 0.0
    assert REGULATION.demand(facing(d=12.8, y=0.51)) == 0.0
    assert REGULATION.demand(facing(v=10.0, d=1.0)) == 0.0  # not closing in


def test_rss_needs_both_distances() -> None:
    # 20 · 0.75 + 0.84375 + 22.25² / 12 − 10² / 12 = 48.766 m
    assert rss_distance_m(np.asarray(20.0), np.asarray(10.0)) == pytest.approx(48.766, abs=1e-3)
    # standing sideways: 0.3 + 0.75² / 2 + 0.75² / 2 = 0.8625 m
    assert rss_lateral_m(np.asarray(0.0)) == pytest.approx(0.8625)
    # coming at 1 m/s: 0.3 + (2 + 0.75) · 0.375 + 1.75² / 2 = 2.8625 m
    assert rss_lateral_m(np.asarray(1.0)) == pytest.approx(2.8625)
    assert RSS.demand(facing(d=48.7, y=2.8, w=1.0)) == FULL_BRAKE_MPS2
    assert RSS.demand(facing(d=48.8, y=2.8, w=1.0)) == 0.0
    assert RSS.demand(facing(d=48.7, y=2.9, w=1.0)) == 0.0


def test_the_fuzzy_metrics() -> None:
    # v = 20, u = 10: 15 − 100/14 = 7.857; unsafe at 7.857 + 400/12 = 41.190, safe at 7.857 + 50 + 2 = 59.857 m
    assert proactive_metric(facing(d=43.1)) == 1.0
    assert proactive_metric(facing(d=62.0)) == 0.0
    assert proactive_metric(facing(d=2.0 + 50.524)) == pytest.approx(0.5, abs=1e-4)
    # 7.5 m in the response, then 100/12 or 100/8: between 15.833 and 20 m
    assert critical_metric(facing(d=15.8)) == 1.0
    assert critical_metric(facing(d=20.1)) == 0.0
    assert critical_metric(facing(d=17.9167)) == pytest.approx(0.5, abs=1e-4)
    # braking with 4 m/s² for 0.75 s makes 17 m/s: 6.375 m, then 49/12 or 49/8: between 10.458 and 12.5 m
    assert critical_metric(facing(d=12.6, a=-6.0)) == 0.0
    assert critical_metric(facing(d=10.4, a=-6.0)) == 1.0
    # 12 m/s would be 9 m/s: equal after 0.5 s and 0.5 m
    assert critical_metric(facing(v=12.0, d=0.51, a=-4.0)) == 0.0
    assert critical_metric(facing(v=12.0, d=0.49, a=-4.0)) == 1.0


def test_the_fuzzy_driver_brakes_by_degrees() -> None:
    assert FSM.demand(facing(d=52.524)) == pytest.approx(2.0, abs=1e-3)
    assert FSM.demand(facing(d=30.0)) == 4.0
    assert FSM.demand(facing(d=17.9167)) == pytest.approx(5.0, abs=1e-3)
    # beside the lane: 1 m at 0.5 m/s takes 2 s, the way past takes (d + 8.6) / 10 + 0.1 s
    assert FSM.demand(facing(d=10.5, y=1.0, w=0.5)) > 0.0
    assert FSM.demand(facing(d=10.3, y=1.0, w=0.5)) == 0.0
    assert FSM.demand(facing(d=10.5, y=1.0, w=0.0)) == 0.0


def test_following_gaps() -> None:
    speed = np.asarray(20.0)
    assert following_gap_m(HUMAN, speed) == 40.0
    # response: 15 + 0.84375 + 22.25²/12 − 15.5²/12 = 37.078; the leader brakes by 6 · 0.75² / 2 = 1.6875 m
    assert following_gap_m(RSS, speed) == pytest.approx(38.766, abs=1e-3)
    assert following_gap_m(FSM, speed) == pytest.approx(15.0 + 400.0 / 8.0 - 400.0 / 14.0 + 4.0)


def test_a_reaction_waits_once_and_then_brakes_at_unsafe_instants_only() -> None:
    demand = [0.0, 7.0, 7.0, 0.0, *[7.0] * 10]
    reaction, accels = Reaction.fresh(HUMAN), []
    for wish in demand:
        reaction, accel = react(reaction, HUMAN, np.asarray(wish), 0.1)
        accels.append(float(accel))
    # eight unsafe instants off the pedal (0.75 s), then 12.65 m/s³ on top of that, up to the demand
    expected = [0, -0.4, -0.4, 0, *[-0.4] * 6, -1.665, -2.93, -4.195, -5.46]
    np.testing.assert_allclose(accels, expected, atol=1e-9)
    reaction, accel = react(reaction, HUMAN, np.asarray(0.0), 0.1)
    assert accel == 0.0
    reaction, accel = react(reaction, HUMAN, np.asarray(7.0), 0.1)
    assert accel == pytest.approx(-1.265)


@given(
    v=st.floats(0.0, 40.0),
    u=st.floats(0.0, 40.0),
    y=st.floats(-3.0, 4.0),
    w=st.floats(0.0, 3.0),
    near=st.floats(0.0, 100.0),
    farther=st.floats(0.0, 100.0),
)
@example(
    v=1.1125369292536007e-308, u=0.0, y=0.0, w=0.0, near=0.0, farther=2.0
)  # closes in, but in no time there is
def test_a_larger_gap_never_requires_more_braking(v, u, y, w, near, farther) -> None:
    for name in ("CC_human_driver", "Reg157", "RSS"):
        model = MODELS[name]
        close, far = (float(model.demand(facing(v, u, d, y, w))) for d in (near, near + farther))
        assert 0.0 <= far <= close <= FULL_BRAKE_MPS2
    for metric in (proactive_metric, critical_metric):
        assert 0.0 <= float(metric(facing(v, u, near + farther))) <= float(metric(facing(v, u, near))) <= 1.0
