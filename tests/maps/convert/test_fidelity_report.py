"""The page about a conversion agrees with the figures."""

from __future__ import annotations

import copy
import re
from pathlib import Path

from small_maps import two_lane_road

from advdiff_sumo.maps.convert import convert_map
from advdiff_sumo.maps.convert.fidelity import measure
from advdiff_sumo.maps.convert.fidelity_report import verdicts, write_page


def test_page_shows_verdicts_pictures_and_figures(tmp_path: Path) -> None:
    result = convert_map(two_lane_road().write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    figures = measure(result).as_dict()
    write_page(result, figures, tmp_path / "m.html")
    page = (tmp_path / "m.html").read_text("utf-8")
    assert len(re.findall(r'class="yes"', page)) == len(verdicts(figures)) >= 7
    assert 'class="no"' not in page
    assert page.count("data:image/png;base64,") == 2
    assert '<td>source lanes</td><td class="v">4</td>' in page
    assert not re.search(r'(src|href)="(?!data:)', page)  # nothing is fetched from elsewhere


def test_each_bar_can_be_missed(tmp_path: Path) -> None:
    result = convert_map(two_lane_road().write(tmp_path / "m.json"), tmp_path / "m.net.xml")
    good = measure(result).as_dict()
    assert all(met for *_, met in verdicts(good))
    bad = copy.deepcopy(good)
    bad["centre_line_error_m"]["source_to_net"]["max"] = 0.21
    bad["centre_line_error_m"]["net_to_source"]["median"] = 0.03
    bad["lanes"].update(lost=["a"], left_out=["z"])
    bad["signals"]["that_stop_nobody"] = ["light"]
    bad["routes_no_lane_follows"] = ["e0 → e1 → e2"]
    bad["connections"].update(lost=[["a", "b"]], invented=[["c", "d"]])
    bad["lane_changes"]["share"] = 0.9
    bad["netconvert_warnings"] = [{"meaning": "not explained"}]
    bad["logged_poses"] = {"poses": 5, "on_a_lane_of_the_net": 4, "differences_above_0.05_m": 1}
    bad["driving_test_in_the_hour"] = {
        "vehicles": 300,
        "emergency_brakings_per_1000_km": 1.0,
        "teleports": 1,
        "collisions_sumo": 1,
        "collisions_boxes": 2,
    }
    bad["driving_test_at_once"] = {**bad["driving_test_in_the_hour"], "vehicles": 50}
    assert not any(met for *_, met in verdicts(bad))
    assert len(verdicts(bad)) == len(verdicts(good)) + 2 + 2 * 4
    names = [name for name, *_ in verdicts(bad)]
    assert "300 vehicles set out within the hour: teleports" in names
    assert "50 vehicles on the road at any time: teleports" in names
