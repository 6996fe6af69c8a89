"""Scenarios of files, before they are judged."""

from __future__ import annotations

from pathlib import Path

import pytest

from advdiff_sumo.experiments.judge_scenario import read_scenarios

CSV = """time_s,agent,class,length_m,width_m,x_m,y_m,yaw_rad,speed_mps,is_target
0.0,ego,car,4.6,1.8,0.0,0.0,0.0,10.0,True
0.1,ego,car,4.6,1.8,1.0,0.0,0.0,10.0,True
"""


@pytest.mark.parametrize("name", ["run-0001", "sd_nuscenes_v1.0-mini_scene-0553"])
def test_a_scenario_is_called_by_all_of_its_file_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.csv"
    path.write_text(CSV)
    (scenario,) = read_scenarios(path)
    assert (scenario.name, scenario.target_id) == (name, "ego")
