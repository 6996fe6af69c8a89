"""Pictures as files."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from advdiff_sumo.core.errors import FileError
from advdiff_sumo.data.episode_states import EpisodeStates
from advdiff_sumo.report.drawing import COLOURS, draw, figure
from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.scene_picture import Role, picture_of
from advdiff_sumo.report.sections import facts_of
from tests.metrics.encounters import record_of, straight


@pytest.mark.parametrize("ending", ["svg", "png"])
def test_same_episode_same_bytes(two_episodes: Path, tmp_path: Path, ending: str) -> None:
    one, two = (figure(two_episodes, 1, tmp_path / f"{name}.{ending}").read_bytes() for name in "ab")
    assert one == two
    assert one.startswith(b"<?xml" if ending == "svg" else b"\x89PNG")


def test_svg_has_everybody_and_no_date(two_episodes: Path, tmp_path: Path) -> None:
    text = figure(two_episodes, 1, tmp_path / "a.svg").read_text(encoding="utf-8")
    ET.fromstring(text)  # noqa: S314 - our own file
    assert COLOURS[Role.TARGET] in text
    assert COLOURS[Role.ATTACKER] in text
    assert "impact" in text
    assert "dc:date" not in text


def test_picture_in_metres(two_episodes: Path) -> None:
    run = FinishedRun.read(two_episodes)
    states = run.states(1)
    assert states is not None
    picture = picture_of(states, run.row(1), run.collisions_of(1), None)
    assert picture.attacker == "bv"
    last = picture.boxes[-1]
    assert last.role is Role.TARGET
    assert last.corners_m.mean(axis=0) == pytest.approx((115.0, 101.0))
    assert last.corners_m[0] == pytest.approx((117.5, 102.0))
    assert last.age == 0.0
    assert [box.label for box in picture.boxes if box.role is Role.TARGET] == ["0", "1", "2", "3"]
    assert [box.label for box in picture.boxes if box.role is Role.ATTACKER] == ["0", "", "2", ""]
    assert picture.view.width_m == pytest.approx(1.5 * picture.view.height_m)
    x0, x1 = draw(picture).axes[0].get_xlim()
    assert (x0, x1) == pytest.approx((picture.view.x0_m, picture.view.x1_m))


@pytest.mark.parametrize(("partner", "told"), [("bv", "collision partner"), (None, "nearest vehicle")])
def test_who_is_near_when_the_target_leaves_the_road_is_no_collision_partner(
    two_episodes: Path, partner: str | None, told: str
) -> None:
    run = FinishedRun.read(two_episodes)
    row = {**run.row(1), "collision_partner": partner, "min_ttc_partner": "bv"}
    states = run.states(1)
    assert states is not None
    drawn = draw(picture_of(states, row, (), None))
    legend = drawn.axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["target, a box a second", told, "impact"]
    facts = facts_of(row, (), ())
    assert (facts["hit"], facts["momentName"]) == (partner == "bv", "Contact")
    assert facts["impact"] == [115.0, 101.0]


def test_close_up_is_of_the_contact_where_the_episode_goes_on() -> None:
    """Of the last seconds of the episode before, without the contact: who leaves the road at 3 s drives on for 7."""
    record = record_of(straight("ego", (0.0, 0.0), 0.0, 20.0, steps=101))
    nobody = dict.fromkeys(("collision_partner", "min_ttc_partner", "min_clearance_partner"))
    row = nobody | {"target_collision": True, "collision_time_s": 3.0, "impact_x_m": 60.0, "impact_y_m": 0.0}
    close_up = picture_of(EpisodeStates(record.tracks, 0), row, (), None).close_up
    assert close_up is not None
    assert (close_up.x0_m, close_up.x1_m) == pytest.approx((1.0, 61.0))  # 60 m around 2 to 60 m


def test_no_such_episode(two_episodes: Path, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="has no episode 9; it has 0 to 1"):
        figure(two_episodes, 9, tmp_path / "a.svg")


def test_only_episodes_that_are_there_are_named(
    make_folder: Callable[..., Path], rows: Any, tmp_path: Path
) -> None:
    """Episode 1 failed before its first instant, or its file of a sweep is damaged."""
    folder = make_folder(
        [rows.episode(0), rows.episode(2)], [], rows.drive(0, "ego", 0.0, 0.0, 10.0, target=True)
    )
    with pytest.raises(FileError, match=r"has no episode 1; it has 0 and 2$"):
        figure(folder, 1, tmp_path / "a.svg")


def test_ending_is_checked_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"a\.gif: is neither \.svg nor \.png"):
        figure(tmp_path / "nothing", 0, tmp_path / "a.gif")


def test_unwritable_place(two_episodes: Path, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        figure(two_episodes, 0, tmp_path / "no" / "a.svg")
