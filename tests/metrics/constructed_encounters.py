"""Encounters with hand-worked verdicts: the motion of the cars, the expected verdict, and the reasons.

Cars are 4 x 2 m; lanes, stop lines (x = -7.2, y = -10.4) and limit (13.89 m/s) are those of
``encounters.crossing``.

Stopping distance of ``CC_human_driver`` from v, by its definition at 10 Hz (the speed of instant i + 1 is
driven for 0.1 s): eight instants with 0.4 m/s² (0.75 s), 0.8 v - 0.144 m, leave v - 0.32; five on which braking
grows by 12.65 m/s³ (1.665, 2.930, 4.195, 5.460, 6.725 m/s²), 0.5 v - 0.663 m, leave u = v - 2.4175; then 0.7593
m/s per instant, n = floor(u / 0.7593) of them, 0.1 (n u - 0.7593 n (n + 1) / 2) m. So D(2) = 1.8, D(5) = 6.0,
D(6) = 7.7, D(10) = 15.6, D(11) = 17.9, D(12) = 20.4, D(14) = 25.7 m. Behind a leader at constant speed, the same
sum over the closing speed c, until it is 0, is the loss of the gap: L(5) = 6.0, L(8) = 11.4, L(9) = 13.4 m.

The safe gap is 0.75 v_f + (v_f² - v_l²) / 12.
"""

from __future__ import annotations

import math

import numpy as np

from advdiff_sumo.core.scene import AgentClass
from tests.metrics.encounter_casts import (
    EAST_ROUTE,
    ENTRY_ROUTE,
    NORTH,
    NORTH_ROUTE,
    RING_ROUTE,
    WALKER,
    WEST_ROUTE,
    Constructed,
    Expected,
    cut_in,
    cut_out,
    hidden_walker,
    left_turn,
    pile_up_ahead,
    pushed,
    red_light,
    roundabout,
    stops_ahead,
)
from tests.metrics.encounters import braking, driven, straight

STRUCK = ("other", (), ("ran_into",), False, False)
STRIKES = ("target", ("ran_into",), (), True, True)

ENCOUNTERS: tuple[Constructed, ...] = (
    Constructed(
        "rear-ended while standing",
        lambda _: (straight("still", (-80, -1.6), 0, 0), straight("fast", (-110, -1.6), 0, 12)),
        # a standing driver remains standing: hit at the full 12 m/s
        Expected(*STRUCK, impact_mps=(12.0, 0.1)),
        # 26 m apart, D(12) = 20.4
        Expected(*STRIKES, spare_m=(5.6, 0.6)),
    ),
    Constructed(
        "avoidable stop of a leader",
        # 30 m behind a leader at 12 m/s that brakes at 3 m/s² from 0.5 s. Perceived at 0.7 s; by 1.5 s 1.4 m are lost
        # (leader 9 m/s), by 2.0 s 1.3 m (9.6 against 7.5), by 2.45 s, when both drive 6.1 m/s, 0.5 m. From there
        # it brakes with the leader, half a metre in total: 30 - 3.7
        lambda _: stops_ahead(30.0, 12.0, 3.0),
        Expected(*STRIKES, spare_m=(26.3, 1.0)),
        # contact at 5.0 s; the target has stood since 4.5 s
        Expected(*STRUCK, impact_mps=(12.0, 0.1)),
    ),
    Constructed(
        "leader brakes hard at two seconds",
        # 18 m behind at 9 m/s; 7 m/s² from 0.5 s stop the leader in 1.29 s and 5.8 m (5.3 by steps). Perceived at
        # 0.6 s: 18 + 4.5 + 5.3 - 5.4 - D(9) 13.4 = 9.0. Contact at 3.1 s; the leader has stood since 1.8 s, so it
        # could be seen
        lambda _: stops_ahead(18.0, 9.0, 7.0),
        Expected(*STRIKES, spare_m=(9.0, 1.0)),
        Expected(*STRUCK, impact_mps=(9.0, 0.1)),
    ),
    Constructed(
        "leader brakes hard at two thirds of a second",
        # 8 m behind at 12 m/s; contact after 3.5 t² = 8, t = 1.5 s: the leader still drives, and 7 m/s² is more
        # braking than must be expected: no breach. The striking vehicle is still at fault (rule of fault), as it
        # followed so closely. Perceived at 0.6 s; the driver is at 23.7 m = 8 + 6 + 9.7 at 2.1 s, at 8.1 m/s, the
        # leader at 0.8 m/s
        lambda _: stops_ahead(8.0, 12.0, 7.0),
        Expected("target", (), (), True, False, impact_mps=(7.3, 1.0)),
        Expected("other", (), (), False, False),
    ),
    Constructed(
        "cut-in at 0.3 s",
        # sideways gap 1.2 m, closed at 1.6 s; then d = 9.5 - 8 = 1.5 m at 5 m/s: 0.3 s. Entered at 1.5 s 2.0 m
        # ahead where 9.75 + 105 / 12 = 18.5 are needed. 0.3 s off the pedal take 0.12 m/s
        lambda _: cut_in(9.5, 41),
        Expected("other", (), ("unsafe_lane_entry",), False, False, impact_mps=(4.9, 0.2)),
        Expected("target", ("unsafe_lane_entry",), (), True),
    ),
    Constructed(
        "cut-in at 3 s",
        # d = 23 - 8 = 15 m when the lateral gap closes; L(5) = 6.0 of it are lost. The contact is at 4.6 s,
        # over 3 s after the entry at 1.5 s: by the rule of fault the lane is its own by then, and the striking
        # vehicle is at fault, although the entry had a gap of 15.5 m where 18.5 m are needed
        lambda _: cut_in(23.0, 61),
        Expected("target", (), ("unsafe_lane_entry",), True, True, spare_m=(9.0, 0.8)),
        Expected("other", ("unsafe_lane_entry",), (), False, False),
    ),
    Constructed(
        "cut-in at 2.5 s",
        # d = 20.5 - 8 = 12.5 m, less L(5); 13.0 m at the entry, 2.6 s before the contact
        lambda _: cut_in(20.5, 61),
        Expected("other", (), ("unsafe_lane_entry",), False, True, spare_m=(6.5, 0.8)),
        Expected("target", ("unsafe_lane_entry",), (), True),
    ),
    Constructed(
        "cut-in with the safe gap",
        # 20.5 m at the entry, 18.5 needed; d = 20 m at 1.6 s, less L(5). Contact at 5.6 s
        lambda _: cut_in(28.0, 71),
        Expected(*STRIKES, spare_m=(14.0, 0.8)),
        Expected(*STRUCK),
    ),
    Constructed(
        "red-light runner",
        # the northward one is on the eastward one's way, y in (-2.6, -0.6), from 6.5 to 7.7 s; contact at 6.86
        # s. Reacting 2 s before (an instant more or less: 1 m), at 10 m/s, D = 15.6 of 20 m; the times overlap
        # until 6.6 s, and from 6.5 to 7.7 s the other is in the corridor (y <= 0): it brakes until it stands
        red_light,
        Expected("other", (), ("red_light",), False, True, spare_m=(3.9, 0.6)),
        # 5 m/s: stops a metre before the line at y = -10.4; the other's side is at -2.6
        Expected("target", ("red_light",), (), True, True, spare_m=(8.8, 1.0)),
        routes=(EAST_ROUTE, NORTH_ROUTE),
        net="traffic_light",
        lights={("WC_1", "CE_1"): "G", ("SC_0", "CN_0"): "r"},
    ),
    Constructed(
        "both run the red light",
        # both ran red: neither has the right of way. The driver stops 1 m before x = -7.2, the other's
        # side is at 0.6; as it rolls to the line, 2 s from the other's way, it brakes fully, and v²/4 becomes
        # v²/15: up to 2 m earlier
        red_light,
        Expected("unclear", ("red_light",), ("red_light",), False, True, spare_m=(9.8, 1.0)),
        Expected("unclear", ("red_light",), ("red_light",), False, True, spare_m=(8.8, 1.0)),
        routes=(EAST_ROUTE, NORTH_ROUTE),
        net="traffic_light",
        lights={("WC_1", "CE_1"): "r", ("SC_0", "CN_0"): "r"},
    ),
    Constructed(
        "runs the red light, but is struck from behind",
        # contact at 14 / 7 = 2 s on the junction; the red light did not lead to it. It binds the driver 4.8 m
        # before the line (7² / 2 (4.8 - 1) = 6.4 m/s²), which 0.75 s off the pedal carry it past: 6.68 m/s
        lambda _: (straight("lead", (-14, -1.6), 0, 7), straight("ego", (-32, -1.6), 0, 14)),
        Expected(*STRUCK, impact_mps=(7.32, 0.05)),
        net="traffic_light",
        lights={("WC_1", "CE_1"): "r"},
    ),
    Constructed(
        "right of way taken",
        # the northward one must give way; contact at 2.86 s, at 2 s before it D(10) = 15.6 of 20 m are enough
        lambda _: (straight("east", (-30, -1.6), 0, 10), straight("north", (1.6, -31), NORTH, 10)),
        Expected("other", (), ("right_of_way",), False, True),
        # 18.6 m to the line: 10² / 2 (18.6 - 1) = 2.8 m/s² bind at once. It stops a metre before the line, 8.8
        # m from the other, or is let go when 1 s lies between them; at 2.6 s it does 4.2 m/s, so it is 4.2 m
        # away as the other leaves
        Expected("target", ("right_of_way",), (), True, True, spare_m=(6.5, 2.3)),
        routes=(EAST_ROUTE, NORTH_ROUTE),
    ),
    Constructed(
        "both to blame: one too fast, one takes its way",
        # 20 m/s where 13.89 are allowed; the party that must yield is at fault. Its driver: as above
        lambda _: (straight("north", (1.6, -31), NORTH, 10), straight("east", (-60, -1.6), 0, 20)),
        Expected("target", ("right_of_way",), ("speeding",), True, True, spare_m=(6.5, 2.3)),
        Expected("other", ("speeding",), ("right_of_way",), False),
        routes=(NORTH_ROUTE, EAST_ROUTE),
    ),
    Constructed(
        "first come at an all-way stop",
        # on the other's way from 4.65 to 6.15 s, and on the junction long before it; the late one arrives at
        # 5.54 s and stops from 10 m/s in 15.6 of the 20 m that are left 2 s before
        lambda _: (straight("slow", (-20, -1.6), 0, 4, 81), straight("late", (1.6, -60), NORTH, 10, 81)),
        Expected("other", (), ("right_of_way",), False),
        Expected("target", ("right_of_way",), (), True, True),
        routes=(EAST_ROUTE, NORTH_ROUTE),
        net="allway_stop",
    ),
    Constructed(
        "left turn across oncoming traffic",
        # D(6) = 7.7 m of 12 m two seconds before the contact, even were there no stop line
        left_turn,
        Expected("target", ("right_of_way",), (), True, True),
        # D(10) = 15.6 of 20 m, and the turning car clears the way
        Expected("other", (), ("right_of_way",), False, True),
        routes=(("WC", "CN"), WEST_ROUTE),
        made_for=True,
    ),
    Constructed(
        "roundabout entry",
        # on the ring: 6 m/s, D = 7.7 of 12 m; the entering car drives on ahead. Entering: the line binds
        roundabout,
        Expected("other", (), ("right_of_way",), False, True),
        Expected("target", ("right_of_way",), (), True, True),
        routes=(RING_ROUTE, ENTRY_ROUTE),
        net="roundabout",
        made_for=True,
    ),
    Constructed(
        "runs into a bus that stands on the junction",
        # the bus stops by 2.5 s at x in (0.35, 2.85); the target's front is there at 78.35 / 11 = 7.12 s.
        # Perceived 5 s before, 55 - D(11) = 37.1
        lambda _: (
            straight("ego", (-80, -1.6), 0, 11, 81),
            driven("bus", (1.6, -20), NORTH, braking(10, 0.6, 5.5, 81), size=(10.0, 2.5)),
        ),
        Expected(*STRIKES, spare_m=(37.1, 1.6)),
        Expected(*STRUCK, impact_mps=(11.0, 0.1), says="is run into at 11.0 m/s"),
        routes=(EAST_ROUTE, NORTH_ROUTE),
    ),
    Constructed(
        "occluded crossing",
        # comes out from behind a van; in the lane at 2.3 s, 8.1 m ahead where 9 + 12 = 21 are needed; on the
        # way until 3.73 s. The record holds it all along, and so does the driver: 2 s before the contact at
        # 2.98 s 23.7 m are left, D = 20.4
        lambda _: hidden_walker(0.0),
        Expected("other", (), ("unsafe_lane_entry",), False, True, spare_m=(1.7, 1.7)),
    ),
    Constructed(
        "occluded crossing, in the record from 0.8 s before the contact on",
        # off the pedal until the contact: 12 - 0.4 * 0.8
        lambda _: hidden_walker(2.15),
        Expected("other", (), ("unsafe_lane_entry",), False, False, impact_mps=(11.7, 0.2)),
    ),
    Constructed(
        "slow pedestrian",
        # in the lane at 0.5 s, 36 m ahead: lawful. In the corridor from 1.1 or 1.2 s on: 41.7 - 13.2 (14.4) -
        # 20.4 = 8.1 (6.9); it leaves it at 3.7 s, when the driver stands
        lambda _: (
            straight("ego", (-150, -4.8), 0, 12, 51),
            driven("walker", (-106, -7.2), NORTH, np.full(51, 1.0), **WALKER),
        ),
        Expected(*STRIKES, spare_m=(7.5, 0.9)),
    ),
    Constructed(
        "pedestrian who stands in the lane",
        lambda _: (
            straight("ego", (-150, -4.8), 0, 12, 51),
            driven("walker", (-106, -4.8), NORTH, np.zeros(51), **WALKER),
        ),
        Expected(*STRIKES, spare_m=(41.7 - 20.4, 0.6)),
    ),
    Constructed(
        "slow cyclist",
        # 26 m behind at 12 against 4 m/s, less L(8); contact at 3.25 s
        lambda _: (
            straight("ego", (-150, -4.8), 0, 12, 51),
            driven(
                "cyclist",
                (-121.1, -4.8),
                0,
                np.full(51, 4.0),
                size=(1.8, 0.6),
                agent_class=AgentClass.BICYCLE,
            ),
        ),
        Expected(*STRIKES, spare_m=(14.6, 0.6)),
        Expected(*STRUCK),
    ),
    Constructed(
        "oncoming overtaker",
        # over the line with its side at y < 0.4 from 1.2 s on, 37.2 m and 1.55 s away at 24 m/s; 0.8 s later
        # 18.1 m, at the end of the growing braking 6.8 m at 9.6 m/s, and 6.5 m/s are left at the contact at
        # 2.85 s
        lambda _: (
            straight("ego", (-150, -1.6), 0, 12),
            straight("coming", (-80, 1.6), math.pi, 12, drift=1.0),
        ),
        Expected("other", (), ("wrong_side",), False, False, impact_mps=(18.5, 1.0)),
        Expected("target", ("wrong_side",), (), True),
        routes=(EAST_ROUTE, WEST_ROUTE),
    ),
    Constructed(
        "wrong-way driver",
        # stands after 2.6 s and 20.4 m, and is hit at (66 - 20.4) / 12 = 3.8 s
        lambda _: (straight("ego", (-150, -4.8), 0, 12), straight("wrong", (-80, -4.8), math.pi, 12)),
        Expected("other", (), ("wrong_side",), False, False, impact_mps=(12.0, 0.1)),
        Expected("target", ("wrong_side",), (), True),
        routes=(EAST_ROUTE, WEST_ROUTE),
    ),
    Constructed(
        "reversing",
        # stands after D(2) = 1.8 m and 1.2 s; the other is there at 14.2 / 6 = 2.4 s
        lambda _: (straight("ego", (-150, -1.6), 0, 2), straight("back", (-130, -1.6), 0, -6)),
        Expected("other", (), ("reversing",), False, False, impact_mps=(6.0, 0.1)),
        Expected("target", ("reversing",), (), True),
    ),
    Constructed(
        "too fast into the rear",
        # 17 m/s (16.67 are 1.2 times the limit) against 8 m/s: 26 m less L(9)
        lambda _: (straight("ego", (-150, -1.6), 0, 17), straight("lead", (-120, -1.6), 0, 8)),
        Expected("target", ("speeding", "ran_into"), (), True, True, spare_m=(12.6, 0.8)),
        Expected("other", (), ("speeding", "ran_into"), False, False, impact_mps=(9.0, 0.1)),
    ),
    Constructed(
        "drifts out of its lane into the side",
        lambda _: (
            straight("steady", (-150, -1.6), 0, 12),
            straight("drifting", (-150, -4.8), 0, 12, drift=1.0),
        ),
        Expected("other", (), ("sideways",), False),
        Expected("target", ("sideways",), (), True),
    ),
    Constructed(
        "drifts within its lane into a vehicle at the line",
        # lanes of 3.2 m, the line at -3.2: they touch where the one box is over it by 0.05 m
        lambda _: (
            straight("steady", (-150, -2.25), 0, 12),
            straight("drifting", (-150, -4.8), 0, 12, drift=1.0),
        ),
        Expected("other", (), ("sideways",), False),
        Expected("target", ("sideways",), (), True),
    ),
    Constructed(
        "both drift into each other",
        # both moved sideways
        lambda _: (
            straight("left", (-150, -1.6), 0, 12, drift=-0.8),
            straight("right", (-150, -4.8), 0, 12, drift=0.8),
        ),
        Expected("unclear", ("sideways",), ("sideways",), False),
        Expected("unclear", ("sideways",), ("sideways",), False),
    ),
    Constructed(
        "contact at walking speed",
        # 1.4 m/s: eight instants make 0.98 m, three more 0.17 m; 5 - 1.15
        lambda _: (straight("ego", (-150, -1.6), 0, 1.4), straight("still", (-141, -1.6), 0, 0)),
        Expected(*STRIKES, spare_m=(3.85, 0.15)),
        Expected(*STRUCK, impact_mps=(1.4, 0.05)),
    ),
    Constructed(
        "pushed by a third into the one ahead",
        # a driver that stands there is pushed by the same third
        pushed,
        Expected(
            "other", (), (), False, False, impact_mps=(10.0, 0.1), says="is run into by 'third' at 10.0 m/s"
        ),
        # the car ahead stands and is hit at 5 m/s by a car that was pushed
        Expected("other", (), (), False, False, impact_mps=(5.0, 0.1)),
    ),
    Constructed(
        "pile-up ahead",
        # the leader stops dead at 1.5 s, 24 m ahead; D(12) = 20.4 m, and it has stood for 2 s at the contact
        pile_up_ahead,
        Expected(*STRIKES),
        Expected(*STRUCK, impact_mps=(12.0, 0.1)),
    ),
    Constructed(
        "cut-out before a standing car",
        # 60 m at first, 48 m when the leader begins to move out, D(12) = 20.4: seen 5 s before, at once, or
        # then
        cut_out,
        Expected(*STRIKES, spare_m=(33.6, 6.5)),
        Expected(*STRUCK, impact_mps=(12.0, 0.1)),
    ),
)
