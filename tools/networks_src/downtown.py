"""The right-hand downtown district: a table of junctions and a table of streets."""

from __future__ import annotations

from networks_src.district import lay_district
from networks_src.plain import Plan
from networks_src.roundabout import Roundabout
from networks_src.streets import Street

JUNCTIONS: dict[str, tuple[float, float]] = {
    "A1": (0, 0), "B1": (104, -4), "C1": (222, -6), "D1": (346, 0), "E1": (468, 8), "F1": (590, 12),
    "G1": (712, 6),
    "A2": (-4, 92), "B2": (104, 92), "C2": (222, 92), "D2": (348, 92), "E2": (470, 96), "F2": (588, 100),
    "G2": (706, 98),
    "A3": (-4, 188), "B3": (104, 194), "C3": (222, 197), "D3": (350, 195), "E3": (472, 188), "F3": (588, 184),
    "G3": (700, 188), "H3": (812, 200),
    "A4": (0, 290), "B4": (104, 296), "C4": (222, 300), "M4": (286, 302), "D4": (352, 302), "E4": (474, 298),
    "G4": (702, 300),
    "A5": (6, 396), "B5": (104, 398), "C5": (222, 398), "M5": (288, 398), "D5": (354, 398), "E5": (476, 400),
    "F5": (590, 404), "G5": (708, 402),
    "B6": (104, 500), "C6": (222, 504), "D6": (356, 500), "E6": (476, 492), "F6": (592, 494),
}  # fmt: skip
KINDS = {
    "traffic_light": ("A3", "B3", "C3", "D3", "F3", "H3", "B1", "C1", "D1", "D2", "D4", "B5", "C5", "D5"),
    "allway_stop": ("F2",),
    "right_before_left": ("E2", "G2", "M4", "B6"),
}
FRINGE: dict[str, tuple[float, float]] = {
    "W1": (-150, 6), "W3": (-190, 178), "W5": (-150, 392), "E1f": (860, -6), "H3f": (990, 222),
    "G5f": (860, 392),
    "S_B": (104, -130), "S_C": (222, -130), "S_D": (344, -140), "S_F": (594, -120),
    "N_B": (104, 620), "N_C": (222, 625), "N_D": (358, 630), "N_F": (600, 620),
}  # fmt: skip
RING = Roundabout("R4", (590.0, 296.0))

ARTERIAL = Street(
    "Meridian Avenue",
    ("W3", "A3", "B3", "C3", "D3", "E3", "F3", "G3", "H3", "H3f"),
    ahead=3, back=3, speed_mps=13.89, priority=10, median_m=3.3, width_m=3.3,
    changes={"D3": (2, 2)}, drops={("A3", "W3"): (70.0, 2)},
    pockets=frozenset(
        {("W3", "A3"), ("B3", "A3"), ("A3", "B3"), ("D3", "C3"), ("C3", "D3"), ("E3", "D3"), ("E3", "F3"),
         ("G3", "F3"), ("G3", "H3"), ("H3f", "H3")}
    ),
)  # fmt: skip
STATION = Street(
    "Station Road",
    ("S_D", "D1", "D2", "D3", "D4", "D5", "D6", "N_D"),
    ahead=2, back=2, speed_mps=13.89, priority=9, median_m=3.2, pocket_m=36.0,
    pockets=frozenset({("S_D", "D1"), ("D2", "D1"), ("D2", "D3"), ("D4", "D3"), ("D3", "D4"), ("D5", "D4"),
                       ("D4", "D5"), ("D3", "D2")}),
)  # fmt: skip
STREETS = (
    ARTERIAL,
    STATION,
    Street("South Street", ("W1", "A1", "B1", "C1", "D1", "E1", "F1", "G1", "E1f"), speed_mps=13.89, priority=6),
    Street("Weaver Lane", ("A2", "B2", "C2", "D2"), ahead=2, back=0, priority=5),
    Street("Weaver Lane East", ("D2", "E2", "F2", "G2"), speed_mps=8.33, priority=3),
    Street("Garden Street", ("A4", "B4", "C4", "M4", "D4", "E4"), priority=4),
    Street(
        "Exchange Street",
        ("G5f", "G5", "F5", "E5", "D5", "M5", "C5", "B5", "A5", "W5"),
        ahead=2, back=0, priority=7,
    ),
    Street(
        "Old Quay",
        ("F6", "E6", "D6", "C6", "B6", (56, 497), (22, 478), (5, 444), "A5", "A4", "A3", "A2", "A1"),
        priority=5,
    ),
    Street("Harbour Street", ("S_B", "B1", "B2", "B3", "B4", "B5", "B6", "N_B"), ahead=2, back=0, priority=7),
    Street("Market Street", ("N_C", "C6", "C5", "C4", "C3", "C2", "C1", "S_C"), ahead=2, back=0, priority=7),
    Street("Chapel Street", ("E1", "E2", "E3"), speed_mps=8.33, priority=3),
    Street("Chapel Rise", ("E4", "E5", "E6"), speed_mps=8.33, priority=3),
    Street("Mill Road", ("S_F", "F1", "F2", "F3"), priority=6),
    Street("Mill Road North", ("F5", "F6", "N_F"), priority=6),
    Street("Brewer Street", ("F6", (652, 490), (690, 462), "G5", "G4", "G3", "G2", "G1"), speed_mps=8.33, priority=3),
    Street(
        "Mill Crescent",
        ("G2", (758, 104), (800, 140), "H3", (806, 258), (766, 292), "G4"),
        speed_mps=8.33, priority=3,
    ),
    Street("Bell Alley", ("M4", "M5"), speed_mps=8.33, priority=2),
)  # fmt: skip
ARMS = ("E4", "G4", "F3", "F5")


def plan() -> Plan:
    """Lay out the district."""
    return lay_district(Plan("downtown"), JUNCTIONS | FRINGE, KINDS, STREETS, RING, ARMS)
