"""The left-hand downtown district: a different town, laid out along a north-south arterial."""

from __future__ import annotations

from networks_src.district import lay_district
from networks_src.plain import Plan
from networks_src.roundabout import Roundabout
from networks_src.streets import Street

JUNCTIONS: dict[str, tuple[float, float]] = {
    "P1": (0, 4), "P2": (-6, 90), "P3": (-8, 184), "P4": (-2, 290), "P5": (4, 384), "P6": (2, 470),
    "K5": (66, 386), "K6": (66, 472),
    "Q1": (130, 0), "Q2": (130, 88), "Q3": (128, 182), "Q4": (128, 294), "Q5": (130, 388), "Q6": (134, 474),
    "Q7": (136, 574),
    "R1": (254, -2), "R2": (254, 88), "R3": (252, 184), "R4": (250, 298), "R5": (252, 390), "R6": (256, 476),
    "R7": (256, 578),
    "S1": (366, 0), "S2": (368, 90), "S3": (368, 188), "S4": (368, 300), "S5": (370, 388), "S7": (374, 576),
    "T1": (488, 6), "T2": (490, 94), "T3": (492, 190), "T4": (492, 296), "T5": (494, 384), "T6": (494, 478),
    "T7": (492, 570),
    "U2": (604, 96), "U3": (604, 188), "U4": (602, 288), "U5": (606, 382), "U6": (608, 476), "U7": (604, 566),
    "V4": (700, 280),
}  # fmt: skip
KINDS = {
    "traffic_light": ("R1", "R2", "R3", "R4", "R5", "R7", "S1", "S2", "S3", "S4", "P4", "U4"),
    "allway_stop": ("T6",),
    "right_before_left": ("Q5", "K5", "T5", "Q6"),
}
FRINGE: dict[str, tuple[float, float]] = {
    "S_R": (258, -190), "S_S": (362, -130), "N_R": (258, 740), "N_S": (376, 700), "W1": (-140, 12),
    "W2": (-150, 86), "W3": (-150, 190), "W4": (-180, 276), "E2": (740, 90), "E3": (745, 196), "E4": (780, 276),
    "E7": (740, 556),
}  # fmt: skip
RING = Roundabout("R6S", (372.0, 478.0))
ARMS = ("R6", "T6", "S5", "S7")

FEDERATION = Street(
    "Federation Road",
    ("S_R", "R1", "R2", "R3", "R4", "R5", "R6", "R7", "N_R"),
    ahead=3, back=3, speed_mps=13.89, priority=10, median_m=3.3, width_m=3.3, pocket_m=34.0,
    changes={"R5": (2, 2)}, drops={("R1", "S_R"): (70.0, 2)},
    pockets=frozenset({("S_R", "R1"), ("R2", "R1"), ("R1", "R2"), ("R4", "R3"), ("R3", "R4"), ("R5", "R4"),
                       ("R4", "R5"), ("R6", "R5"), ("R6", "R7"), ("N_R", "R7")}),
)  # fmt: skip
QUAY = Street(
    "Quay Road",
    ("W4", "P4", "Q4", "R4", "S4", "T4", "U4", "V4", "E4"),
    ahead=2, back=2, speed_mps=13.89, priority=9, median_m=3.2, pocket_m=40.0,
    pockets=frozenset({("W4", "P4"), ("Q4", "P4"), ("Q4", "R4"), ("S4", "R4"), ("R4", "S4"), ("T4", "S4"),
                       ("T4", "U4"), ("V4", "U4")}),
)  # fmt: skip
STREETS = (
    FEDERATION,
    QUAY,
    Street(
        "Ferry Street",
        ("W1", "P1", "Q1", "R1", "S1", "T1", (548, 14), (588, 46), "U2", "U3", "U4", "U5", "U6", "U7"),
        priority=5,
    ),
    Street("Customs Street", ("W2", "P2", "Q2", "R2", "S2", "T2", "U2", "E2"), ahead=2, back=0, priority=7),
    Street("Wharf Street", ("E3", "U3", "T3", "S3", "R3", "Q3", "P3", "W3"), ahead=2, back=0, priority=7),
    Street("Orchard Street", ("P5", "K5", "Q5", "R5", "S5", "T5", "U5"), speed_mps=8.33, priority=3),
    Street("Chandler Street", ("P6", "K6", "Q6", "R6"), speed_mps=8.33, priority=3),
    Street("Chandler Street East", ("T6", "U6"), speed_mps=8.33, priority=3),
    Street(
        "Signal Hill",
        ("E7", "U7", "T7", "S7", "R7", "Q7", (76, 566), (28, 534), "P6", "P5", "P4", "P3", "P2", "P1"),
        priority=5,
    ),
    Street("Tailor Street", ("Q1", "Q2", "Q3"), speed_mps=8.33, priority=3),
    Street("Tailor Street North", ("Q4", "Q5", "Q6", "Q7"), speed_mps=8.33, priority=3),
    Street("Station Street", ("S_S", "S1", "S2", "S3", "S4", "S5"), priority=6),
    Street("Station Street North", ("S7", "N_S"), priority=4),
    Street("Cooper Street", ("T1", "T2", "T3", "T4"), priority=4),
    Street("Cooper Street North", ("T5", "T6", "T7"), speed_mps=8.33, priority=3),
    Street("Bay Crescent", ("V4", (704, 330), (708, 390), (680, 448), "U6"), speed_mps=8.33, priority=2),
    Street("Rope Lane", ("K5", "K6"), speed_mps=8.33, priority=2),
)  # fmt: skip


def plan() -> Plan:
    """Lay out the district."""
    return lay_district(Plan("downtown-left", lefthand=True), JUNCTIONS | FRINGE, KINDS, STREETS, RING, ARMS)
