"""Film strips and films as files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from advdiff_sumo.core.errors import ConfigError, FileError
from advdiff_sumo.report.selection import ChosenEpisode, poses_at
from advdiff_sumo.report.strip import draw_strip, film_strip
from advdiff_sumo.report.video import video


@pytest.mark.parametrize("ending", ["svg", "png"])
def test_same_episode_same_strip(sweep_folder: Path, tmp_path: Path, ending: str) -> None:
    one, two = (film_strip(sweep_folder, None, tmp_path / f"{name}.{ending}").read_bytes() for name in "ab")
    assert one == two
    assert one.startswith(b"<?xml" if ending == "svg" else b"\x89PNG")


def test_strip_of_the_worst_ends_at_its_contact(sweep_folder: Path) -> None:
    chosen = ChosenEpisode.read(sweep_folder, None)
    assert chosen.row["episode"] == 1
    assert chosen.span_s(None, None, 6.0) == (0.0, 3.0)
    assert chosen.natural is not None
    assert chosen.natural.ids == ("ego", "bv")
    drawn = draw_strip(chosen, np.linspace(0.0, 3.0, 4), 0.0)
    assert [axes.texts[0].get_text() for axes in drawn.axes] == ["0.0 s", "1.0 s", "2.0 s", "3.0 s"]
    crosses = [sum(line.get_marker() == "x" for line in axes.lines) for axes in drawn.axes]
    assert crosses == [0, 0, 0, 1]
    circles = [sum(line.get_marker() == "o" for line in axes.lines) for axes in drawn.axes]
    assert circles == [2, 6, 10, 14]  # two vehicles, one circle each 0.5 s
    labels = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert labels == [
        "target",
        "collision partner",
        "others",
        "driven, every 0.5 s",
        "without attack",
        "contact",
    ]


def test_who_is_near_when_the_target_leaves_the_road_is_no_collision_partner(sweep_folder: Path) -> None:
    chosen = ChosenEpisode.read(sweep_folder, 1)
    off = replace(chosen, row={**chosen.row, "collision_partner": None, "min_ttc_partner": "bv"})
    assert off.attacker == chosen.attacker
    drawn = draw_strip(off, np.linspace(0.0, 3.0, 4), 0.0)
    labels = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert labels[:3] == ["target", "nearest vehicle", "others"]
    assert labels[-1] == "contact"


def test_panels_go_along_with_a_target_that_drives_far(sweep_folder: Path) -> None:
    """Both drive 40 m/s faster to the east than they did: 120 m in three seconds."""
    chosen = ChosenEpisode.read(sweep_folder, 1)
    near = [axes.get_xlim() for axes in draw_strip(chosen, np.array([0.0, 3.0]), 0.0).axes]
    assert near[0] == near[1]
    tracks = chosen.states.tracks
    tracks.xy_m[..., 0] += 40.0 * tracks.dt_s * np.arange(tracks.steps)
    far = np.array([axes.get_xlim() for axes in draw_strip(chosen, np.array([0.0, 3.0]), 0.0).axes])
    widths = np.ptp(far, axis=1)
    assert widths[0] == pytest.approx(widths[1])
    assert widths[0] < 90.0
    for moment, (west, east) in zip((0.0, 3.0), far.tolist(), strict=True):
        assert west < poses_at(tracks, moment)[0][chosen.states.target, 0] < east


def test_strip_ends_at_the_contact_where_the_episode_goes_on(sweep_folder: Path) -> None:
    """A second later before; who leaves the road, say, drives on."""
    chosen = ChosenEpisode.read(sweep_folder, 1)
    early = replace(chosen, row={**chosen.row, "collision_time_s": 1.54})
    assert early.span_s(None, None, 6.0) == (0.0, 1.54)


def test_poses_between_instants_take_the_shorter_turn(sweep_folder: Path) -> None:
    tracks = ChosenEpisode.read(sweep_folder, 1).states.tracks
    tracks.yaw_rad[0, 10:12] = 3.1, -3.1
    xy, yaw = poses_at(tracks, 1.05)
    assert xy[0] == pytest.approx((415.5, 410.0))
    assert abs(float(yaw[0])) == pytest.approx(np.pi)
    assert poses_at(tracks, 3.0)[0][1] == pytest.approx((440.0, 410.0))


def test_stretch_must_be_in_the_episode(sweep_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="5 to 9 s is no stretch of the episode; it lasts from 0 to 3 s"):
        film_strip(sweep_folder, 1, tmp_path / "a.png", start_s=5.0, end_s=9.0)


def test_gif_has_ten_pictures_a_second_and_repeats(sweep_folder: Path, tmp_path: Path) -> None:
    one, two = (video(sweep_folder, 1, tmp_path / f"{name}.gif", speed=2.0, start_s=1.0) for name in "ab")
    assert one.read_bytes() == two.read_bytes()
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.gif", "b.gif"]
    with Image.open(one) as film:
        assert film.size == (960, 640)
        lasted = 0
        for frame in range(film.n_frames):
            film.seek(frame)
            lasted += film.info["duration"]
        assert lasted == 2000  # 2 s at double speed, and 1 s of the last picture
        last = np.asarray(film.convert("RGB"), dtype=np.int64)
    red = (last[..., 0] > 150) & (last[..., 1] < 60)
    assert red.sum() > 100  # the contact


def test_mp4_repeats(sweep_folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="no ffmpeg here: pip install 'advdiff-sumo[video]'")
    one, two = (video(sweep_folder, 1, tmp_path / f"{name}.mp4", start_s=2.0).read_bytes() for name in "ab")
    assert one == two
    assert one[4:8] == b"ftyp"


@pytest.mark.parametrize("ending", ["gif", "mp4"])
def test_place_that_is_not_there(sweep_folder: Path, tmp_path: Path, ending: str) -> None:
    if ending == "mp4":
        pytest.importorskip("imageio_ffmpeg", reason="no ffmpeg here: pip install 'advdiff-sumo[video]'")
    with pytest.raises(FileError, match="cannot be written"):
        video(sweep_folder, 1, tmp_path / "no" / f"a.{ending}", start_s=2.5)
