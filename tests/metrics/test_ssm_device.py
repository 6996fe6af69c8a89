"""TTC, DRAC and PET compared with those of SUMO's SSM device, which logs every instant.

https://sumo.dlr.de/docs/Simulation/Output/SSM_Device.html. Both evaluate the same vehicles, driven by libsumo at given
speeds; tolerances are those of docs/metrics.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from defusedxml import ElementTree

from advdiff_sumo.core.arrays import FloatArray
from advdiff_sumo.core.scene import Tracks
from advdiff_sumo.maps import RoadMap
from advdiff_sumo.metrics.criticality import time_to_collision
from advdiff_sumo.metrics.encroachment import post_encroachment
from advdiff_sumo.metrics.following import following_gaps
from tests.sim import nets

DT_S = 0.1
LANE_TTC_S, DRAC_MPS2 = 1e-4, 1e-4
PLANE_TTC_S = 0.02
CROSSING_TTC_S = 1e-4
PET_S = 0.03
MEASURES = ("TTC", "DRAC", "PET")


class Drive:
    """Two vehicles on a net, with the device on the target, and the results of both."""

    def __init__(self, net: Path, width_m: float = nets.WIDTH_M) -> None:
        self.road, self.width_m = RoadMap.read(net), width_m
        self.log = net.parent / "ssm.xml"
        self.rows: dict[str, list[tuple[float, float, float, float]]] = {"other": [], "target": []}
        self.times: list[float] = []

    def run(
        self,
        starts: Mapping[str, tuple[list[str], float]],
        speeds: Mapping[str, FloatArray],
    ) -> None:
        """Drive from (route, position of the bumper) with the given speeds, one per instant."""
        with nets.stage(self.road.path, otherwise=self._options()) as stage:
            for name, (route, at) in starts.items():
                stage.add(name, route, at=at, speed=0.0)
                stage.api.vehicle.setWidth(name, self.width_m)
                stage.free(name)
                stage.api.vehicle.setSpeed(name, 0.0)
            for now in zip(*speeds.values(), strict=True):
                for name, speed in zip(speeds, now, strict=True):
                    stage.api.vehicle.setSpeed(name, float(speed))
                stage.step()
                self.times.append(stage.api.simulation.getTime())
                for name in self.rows:
                    (x, y), yaw = stage.pose(name)
                    self.rows[name].append((x, y, yaw, stage.api.vehicle.getSpeed(name)))

    def _options(self) -> dict[str, object]:
        thresholds = {"TTC": 50.0, "DRAC": 0.0, "PET": 50.0}
        return {
            "--device.ssm.explicit": "target",
            "--device.ssm.measures": " ".join(MEASURES),
            "--device.ssm.thresholds": " ".join(str(thresholds[name]) for name in MEASURES),
            "--device.ssm.range": 200,
            "--device.ssm.extratime": 20,
            "--device.ssm.trajectories": "true",
            "--device.ssm.file": self.log,
            "--precision": 6,
        }

    @property
    def tracks(self) -> Tracks:
        """The record made by this package."""
        rows = np.array([self.rows["target"], self.rows["other"]])
        return Tracks(
            ids=("target", "other"),
            classes=np.zeros(2, dtype=np.int64),
            size_m=np.full((2, 2), (nets.LENGTH_M, self.width_m)),
            xy_m=rows[..., :2],
            yaw_rad=rows[..., 2],
            speed_mps=rows[..., 3],
            valid=np.ones(rows.shape[:2], dtype=np.bool_),
            t0_s=0.0,
            dt_s=DT_S,
        )

    def theirs(self, measure: str) -> FloatArray:
        """Return the device's values at our instants; NaN where it has none."""
        (conflict,) = ElementTree.fromstring(self.log.read_bytes()).iter("conflict")
        words = conflict.find("timeSpan").get("values").split()
        values = conflict.find(f"{measure}Span").get("values").split()
        at = {
            round(float(t), 3): np.nan if v == "NA" else float(v) for t, v in zip(words, values, strict=True)
        }
        # the device logs before the clock advances: its time t is our time t + one step
        return np.array([at.get(round(time - DT_S, 3), np.nan) for time in self.times])

    def extreme(self, tag: str) -> float:
        """Return a value of the device's summary."""
        (conflict,) = ElementTree.fromstring(self.log.read_bytes()).iter("conflict")
        return float(conflict.find(tag).get("value"))


STEPS = 90
TIME_S = DT_S * np.arange(STEPS)
STREET = {"other": (["WM", "ME"], 100.0), "target": (["WM", "ME"], 20.0)}


@pytest.mark.parametrize(
    ("speeds", "plane_s"),
    [
        ({"other": np.full(STEPS, 6.0), "target": np.full(STEPS, 12.0)}, 1e-4),
        ({"other": 6.0 - 0.3 * TIME_S, "target": 13.0 - 0.5 * TIME_S}, PLANE_TTC_S),
    ],
    ids=["steady", "both braking"],
)
def test_following(speeds: Mapping[str, FloatArray], plane_s: float, tmp_path: Path) -> None:
    """Lane TTC and DRAC equal the device's; the TTC of boxes uses speeds from positions, half a step of braking off."""
    drive = Drive(nets.street(tmp_path))
    drive.run(STREET, speeds)
    theirs, drac = drive.theirs("TTC"), drive.theirs("DRAC")
    assert np.isfinite(theirs).sum() == np.isfinite(drac).sum() == STEPS
    ours = following_gaps(drive.tracks, 0, drive.road, ("WM", "ME"))
    assert ours.time_to_collision()[1] == pytest.approx(theirs, abs=LANE_TTC_S)
    assert ours.deceleration_to_avoid()[1] == pytest.approx(drac, abs=DRAC_MPS2)
    boxes = time_to_collision(drive.tracks, 0)[1]
    near = np.isfinite(boxes) & (
        np.arange(STEPS) > 0
    )  # at the first instant the speed comes from one step only
    assert near.sum() > 40
    assert boxes[near] == pytest.approx(theirs[near], abs=plane_s)


@pytest.mark.parametrize(("width_m", "target_mps"), [(nets.WIDTH_M, 8.0), (2.5, 8.0), (nets.WIDTH_M, 6.0)])
def test_crossing_one_after_the_other(width_m: float, target_mps: float, tmp_path: Path) -> None:
    """The other leaves the conflict area and the target enters it later: PET, also worked by hand."""
    drive = Drive(nets.crossing(tmp_path), width_m)
    steps = round(130.0 / target_mps / DT_S)
    speeds = {"other": np.full(steps, 9.0), "target": np.full(steps, target_mps)}
    drive.run({"other": (["SC", "CN"], 80.0), "target": (["WC", "CE"], 60.0)}, speeds)
    ours = post_encroachment(drive.tracks, 0)
    assert ours is not None
    assert ours.value == pytest.approx(drive.extreme("PET"), abs=PET_S)
    (x, _, _, _), (_, y, _, _) = drive.rows["target"][0], drive.rows["other"][0]
    half = 0.5 * (nets.LENGTH_M + width_m)  # centre to centre when the conflict area is entered or left
    entered, left = (1.6 - half - x) / target_mps, (-1.6 + half - y) / 9.0
    assert ours.value == pytest.approx(entered - left, abs=PET_S)


def test_crossing_into_each_other(tmp_path: Path) -> None:
    """On a collision course the device counts until the second enters the area that the first still occupies."""
    drive = Drive(nets.crossing(tmp_path))
    speeds = {"other": np.full(70, 9.0), "target": np.full(70, 9.0)}
    drive.run({"other": (["SC", "CN"], 80.0), "target": (["WC", "CE"], 78.0)}, speeds)
    theirs, ours = drive.theirs("TTC"), time_to_collision(drive.tracks, 0)[1]
    both = np.isfinite(theirs) & np.isfinite(ours) & (ours > 0.0)
    assert both.sum() > 20
    assert ours[both] == pytest.approx(theirs[both], abs=CROSSING_TTC_S)
