"""List all defects: what each stands for, its parameter and severities, and its form in SUMO's driver models."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from advdiff_sumo.planners.defects import actuation, ignored_rules, misjudgement, sensing, stale_tracks
from advdiff_sumo.planners.defects.planted_defect import PlantedDefect
from advdiff_sumo.planners.planner_protocol import LEFT_OFFSET_M

SEVERITIES = ("weak", "middle", "strong")
SumoParams = Mapping[str, float]
_MODELS_SEE = "SUMO's driver models are given their leaders and foes by SUMO, and no attribute"


@dataclass(frozen=True)
class DefectKind:
    """One entry of the catalogue.

    Attributes:
        name: name that ``--defect`` takes.
        stands_for: what fails like this in a real stack.
        parameter: meaning of the value.
        unit: of the value.
        values: values of the three severities, the weakest first.
        bounds: smallest and largest value allowed.
        fault: returns the fault of a value.
        sumo: returns the vType attributes of a value (``tau``: change of the target's own); None if SUMO has none.
        sumo_note: text: the attributes, or why there are none.
    """

    name: str
    stands_for: str
    parameter: str
    unit: str
    values: tuple[float, float, float]
    bounds: tuple[float, float]
    fault: Callable[[float], PlantedDefect]
    sumo: Callable[[float], SumoParams] | None = None
    sumo_note: str = ""

    @property
    def severities(self) -> str:
        """The values of the three severities with their unit."""
        return f"{', '.join(f'{value:g}' for value in self.values)} {self.unit}".strip()

    @property
    def description(self) -> str:
        """What it stands for, its parameter and severities, and its form in SUMO's driver models."""
        sumo = f"; in SUMO's driver models: {self.sumo_note.replace('`', '')}" if self.sumo else ""
        return f"{self.stands_for} ({self.parameter}: {self.severities}){sumo}"


def _brakes(value: float) -> SumoParams:
    return {"decel": value, "emergencyDecel": value}


def _priority(share: float) -> SumoParams:
    return {"jmIgnoreFoeProb": share, "jmIgnoreFoeSpeed": 1000.0, "jmIgnoreJunctionFoeProb": share}


_KINDS = (
    DefectKind(
        "late",
        "latency from sensor to planner",
        "age of what is known of the others and of the signals",
        "s",
        (0.5, 1.0, 2.0),
        (0.0, 5.0),
        stale_tracks.Late,
        lambda s: {"actionStepLength": max(s, 0.1)},
        "`actionStepLength`, SUMO's reaction time",
    ),
    DefectKind(
        "range",
        "short sight: fog, dirt on the lens",
        "distance beyond which nobody is seen",
        "m",
        (30.0, 20.0, 12.0),
        (0.0, 500.0),
        sensing.ShortRange,
        sumo_note=f"none: {_MODELS_SEE} bounds how far away",
    ),
    DefectKind(
        "flicker",
        "detections that come and go, and no tracker to bridge the gaps",
        "share of the plans for which each other is missed",
        "",
        (0.3, 0.6, 0.9),
        (0.0, 1.0),
        sensing.Flicker,
        sumo_note=f"none: {_MODELS_SEE} makes them miss one now and then",
    ),
    DefectKind(
        "dropout",
        "lost tracks: occlusion, a sensor that restarts",
        f"time in every {sensing.DROPOUT_PERIOD_S:g} s for which each other is lost",
        "s",
        (1.0, 2.0, 4.0),
        (0.0, sensing.DROPOUT_PERIOD_S),
        sensing.Dropout,
        sumo_note=f"none: {_MODELS_SEE} makes them lose one for a while",
    ),
    DefectKind(
        "tunnel",
        "no sensors to the sides and behind",
        "field of view",
        "deg",
        (120.0, 60.0, 20.0),
        (0.0, 360.0),
        sensing.TunnelView,
        sumo_note=f"none: {_MODELS_SEE} bounds the angle",
    ),
    DefectKind(
        "blind-crossing",
        "a radar or tracker that drops crossing motion",
        "headings around a right angle that are not seen (half width)",
        "deg",
        (10.0, 25.0, 60.0),
        (0.0, 90.0),
        sensing.BlindToCrossing,
        sumo_note=f"none: {_MODELS_SEE} tells directions apart (`priority` makes them drive on at junctions)",
    ),
    DefectKind(
        "blind-oncoming",
        "oncoming traffic filtered out",
        "headings around the opposite one that are not seen (half width)",
        "deg",
        (10.0, 25.0, 60.0),
        (0.0, 90.0),
        sensing.BlindToOncoming,
        sumo_note=f"none: {_MODELS_SEE} tells directions apart (`priority` makes them turn left before the oncoming)",
    ),
    DefectKind(
        "blind-standing",
        "a radar that drops all that stands, to be rid of bridges and guard rails",
        "speed below which nobody is seen",
        "m/s",
        (0.5, 2.0, 5.0),
        (0.0, 50.0),
        sensing.BlindToStanding,
        sumo_note=f"none: {_MODELS_SEE} hides those that stand",
    ),
    DefectKind(
        "blind-heavy",
        "lorries and buses not recognised: rare in the training data",
        "distance beyond which lorries and buses are not seen",
        "m",
        (20.0, 10.0, 0.0),
        (0.0, 500.0),
        sensing.blind_to_heavy,
        sumo_note=f"none: {_MODELS_SEE} tells classes apart",
    ),
    DefectKind(
        "blind-unprotected",
        "motorcycles, bicycles and pedestrians not recognised",
        "distance beyond which they are not seen",
        "m",
        (12.0, 6.0, 0.0),
        (0.0, 500.0),
        sensing.blind_to_unprotected,
        sumo_note=f"none: {_MODELS_SEE} tells classes apart",
    ),
    DefectKind(
        "frozen",
        "prediction that keeps the others where they are",
        "share of the others' motion that is left out",
        "",
        (0.5, 0.75, 1.0),
        (0.0, 1.0),
        misjudgement.FrozenPrediction,
        sumo_note=f"none: {_MODELS_SEE} scales the others' speed",
    ),
    DefectKind(
        "constant-velocity",
        "prediction by constant velocity from a track that is updated late",
        "time for which the others' last known velocity is believed",
        "s",
        (1.0, 2.0, 3.0),
        (0.0, 5.0),
        stale_tracks.ConstantVelocity,
        sumo_note=f"none: {_MODELS_SEE} keeps an old velocity",
    ),
    DefectKind(
        "speed-bias",
        "speeds measured too high: a Doppler bias",
        "how much faster the others seem",
        "m/s",
        (1.0, 3.0, 6.0),
        (-20.0, 20.0),
        misjudgement.SpeedBias,
        sumo_note=f"none: {_MODELS_SEE} adds to the others' speed",
    ),
    DefectKind(
        "position-bias",
        "a sensor mounted askew or calibrated wrongly",
        "how much farther to the left the others seem",
        "m",
        (0.5, 1.5, 3.0),
        (-10.0, 10.0),
        misjudgement.PositionBias,
        sumo_note=f"none: {_MODELS_SEE} displaces them",
    ),
    DefectKind(
        "localisation",
        "a wrong place on the map: GNSS in a street canyon",
        "how far to the left of its place the target believes to be",
        "m",
        (0.5, 1.0, 2.0),
        (-10.0, 10.0),
        misjudgement.LocalisationOffset,
        lambda m: {LEFT_OFFSET_M: -m},
        "`latAlignment`, on sublanes; SUMO keeps the vehicle within its lane",
    ),
    DefectKind(
        "weak-brakes",
        "worn or wet brakes, a heavy load",
        "strongest braking",
        "m/s²",
        (4.0, 2.5, 1.5),
        (0.1, 9.0),
        actuation.WeakBrakes,
        _brakes,
        "`decel` and `emergencyDecel`",
    ),
    DefectKind(
        "slow-brakes",
        "brakes that build up slowly: a filter, a limit on jerk",
        "time to full braking (9 m/s²)",
        "s",
        (1.0, 2.0, 4.0),
        (0.1, 20.0),
        actuation.SlowBrakes,
        sumo_note="none: SUMO's driver models brake as hard as they decide to, at once",
    ),
    DefectKind(
        "headway",
        "following too close: a gap tuned for comfort",
        "time headway that is lacking",
        "s",
        (0.4, 0.8, 1.2),
        (0.0, 5.0),
        misjudgement.ShortHeadway,
        lambda s: {"tau": -s},
        "`tau`, less by so much than the target's own (SUMO's is 1 s), 0.1 s at least; none for W99, Wiedemann and "
        "CACC, which follow no closer for it",
    ),
    DefectKind(
        "signals",
        "red lights taken for green: a wrong light, low sun",
        "time for which a red light on the own way is taken for green (yellow always is)",
        "s",
        (1.0, 4.0, 60.0),
        (0.0, 3600.0),
        ignored_rules.IgnoredSignals,
        lambda s: {"jmDriveAfterRedTime": s, "jmDriveRedSpeed": 100.0},
        "`jmDriveAfterRedTime`",
    ),
    DefectKind(
        "priority",
        "the right of way misread: a sign missing in the map",
        "share of those with the right of way that are not seen on their way over the junction",
        "",
        (0.25, 0.5, 1.0),
        (0.0, 1.0),
        ignored_rules.IgnoredPriority,
        _priority,
        "`jmIgnoreFoeProb`, `jmIgnoreJunctionFoeProb`, `jmIgnoreFoeSpeed`",
    ),
    DefectKind(
        "cut-in",
        "others kept on their lane: intent is not predicted",
        "time after which a change of lanes is noticed; before it is complete it never is",
        "s",
        (0.5, 1.5, 3.0),
        (0.0, 10.0),
        ignored_rules.IgnoredCutIns,
        sumo_note=f"none: {_MODELS_SEE} keeps one in the lane that it has left",
    ),
    DefectKind(
        "stuck",
        "a planner that does not come back in time: the last plan is driven on",
        "time between two plans",
        "s",
        (1.0, 2.0, 4.0),
        (0.0, 30.0),
        actuation.StuckReplanning,
        lambda s: {"actionStepLength": max(s, 0.1)},
        "`actionStepLength`: between its actions SUMO keeps the acceleration",
    ),
)
DEFECTS: Mapping[str, DefectKind] = {kind.name: kind for kind in _KINDS}
"""All defects by name."""


def catalogue_table() -> str:
    """Return all defects with their severities as a Markdown table, and a line with those that SUMO has, too."""
    lines = ["| defect | stands for | weak, middle, strong |", "|---|---|---|"]
    lines += [f"| `{kind.name}` | {kind.stands_for} | {kind.severities} |" for kind in DEFECTS.values()]
    in_sumo = ", ".join(f"`{kind.name}`" for kind in DEFECTS.values() if kind.sumo)
    return "\n".join([*lines, "", f"In SUMO's driver models, too: {in_sumo}."]) + "\n"
