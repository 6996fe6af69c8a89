"""The page of run folders made by hand."""

from __future__ import annotations

import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from advdiff_sumo import load
from advdiff_sumo.core.errors import FileError
from advdiff_sumo.report import sections
from advdiff_sumo.report.page import own_modules, write_report
from advdiff_sumo.report.templates import further_offences, number, percent

VOID = {"meta", "br", "rect", "circle", "path", "use", "input"}


class Outline(HTMLParser):
    """Collects tags, ids, links and text, and checks that elements close in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(html)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join("".join(self.words).split())

    def values(self, name: str) -> list[str]:
        return [attrs[name] or "" for _, attrs in self.tags if name in attrs]


def _read(folder: Path) -> Outline:
    return Outline(write_report(folder).read_text(encoding="utf-8"))


def test_says_what_was_run_and_how_to_repeat_it(two_episodes: Path) -> None:
    text = _read(two_episodes).text
    assert "IDM in replayed traffic" in text
    assert "2 episodes of at most 20.0 s" in text
    assert "advdiff-sumo run --config run.toml" in text


def test_names_planted_defects(make_folder: Any, rows: Any) -> None:
    planted = {"target_options": {"defects": ["range:strong"]}}
    outline = _read(make_folder([rows.episode(0)], options=planted))
    assert "IDM (range:strong) in replayed traffic" in outline.text


@pytest.mark.parametrize(
    ("background", "options", "title"),
    [
        ("sumo", {}, "IDM in SUMO traffic"),
        ("scripted", {}, "IDM against scripted traffic"),
        ("diffusion", {"attack": "cut-in"}, "IDM against diffusion traffic"),
        ("diffusion", {"guide": "none"}, "IDM in unguided diffusion traffic"),
        ("diffusion", {"strength": 0.0}, "IDM in unguided diffusion traffic"),
        ("traj2traj", {}, "IDM in traj2traj traffic"),
        ("examples.coast:Coast", {}, "IDM in examples.coast:Coast traffic"),
    ],
)
def test_a_target_is_against_those_who_attack(
    make_folder: Any, rows: Any, background: str, options: dict[str, Any], title: str
) -> None:
    asked = {"background": background, "background_options": options}
    assert title in _read(make_folder([rows.episode(0)], options=asked)).text


def test_rates_with_intervals_and_sample_sizes(two_episodes: Path) -> None:
    text = _read(two_episodes).text
    # 1 of 2: centre 1/2, half width z / (2 sqrt(2 + z²)) = 0.4055
    assert "50.0 % 1 of 2 finished episodes95 % interval 9.5 % to 90.5 %" in text
    # 0 of 2: z² / (2 + z²) = 0.6576
    assert "0.0 % 0 of 2 finished episodes95 % interval 0.0 % to 65.8 %" in text


def test_collisions_come_first(two_episodes: Path) -> None:
    outline = _read(two_episodes)
    sections = [attrs["id"] for tag, attrs in outline.tags if tag == "article"]
    assert sections == ["episode-1", "episode-0"]
    table = [a["data-v"] for tag, a in outline.tags if tag == "th" and "data-v" in a]
    assert table == ["1", "0"]
    assert "Episode 1: rear end striking at 3.0 s" in outline.text
    assert "At fault: target. It drove into the rear." in outline.text
    assert "Episode 0: no collision, least time to collision 4.25 s" in outline.text


def test_says_in_which_order_the_episodes_stand(two_episodes: Path) -> None:
    order = "then failures, then critical near misses, the hardest braking first, then broken rules, then the rest,"
    assert f"{order} from the least time to collision up." in _read(two_episodes).text


def test_pictures_show_target_attacker_others_and_impact(two_episodes: Path) -> None:
    html = write_report(two_episodes).read_text(encoding="utf-8")
    hit = html[html.index('id="episode-1"') : html.index('id="episode-0"')]
    # the view is centred on both paths, 85 to 120 m, 101 m, and 70 m wide: the impact is 35 + 12.5 m to the right
    x, y, half = 4750, 2333, 98
    # a box a second from 0 to 3 s for each of the two
    assert hit.count('class="box target past"') == hit.count('class="box attacker past"') == 3
    assert hit.count('class="box target"') == hit.count('class="box attacker"') == 1
    assert re.findall(r'class="trail (\w+)"', hit) == ["attacker", "target"]
    assert hit.count('class="impact"') == 2  # in the picture and in the close-up
    assert f'd="M{x - half} {y - half}l' in hit
    assert '<use href="#scene-1"/>' in hit
    quiet = html[html.index('id="episode-0"') :]
    assert 'class="impact"' not in quiet
    assert "<use" not in quiet


def test_target_without_contact_time_to_collision_and_its_neighbour(two_episodes: Path) -> None:
    labels = _read(two_episodes).values("aria-label")
    assert "Gap to the nearest of the target: least 8.0 m at 0.0 s, greatest 8.0 m at 0.0 s" in labels
    assert "Time to collision: nothing to show" in labels


def test_missing_net_is_said_and_everything_else_is_there(two_episodes: Path) -> None:
    outline = _read(two_episodes)
    assert "Drawn without streets: the net /nowhere/lost.net.xml is no longer there." in outline.text
    assert {attrs["d"] for tag, attrs in outline.tags if attrs.get("class") == "area"} == {""}


def test_net_is_found_beside_the_run(two_episodes: Path, networks: Path) -> None:
    (two_episodes / "lost.net.xml").write_bytes((networks / "motorway.net.xml").read_bytes())
    assert "Drawn without streets" not in _read(two_episodes).text


def test_shipped_net_is_found_by_name_and_drawn(make_folder: Callable[..., Path], rows: Any) -> None:
    states = rows.drive(0, "ego", 300.0, 300.0, 10.0, target=True)
    outline = _read(make_folder([rows.episode(0)], states, options={"net": "downtown"}))
    overview = next(a["d"] for _, a in outline.tags if a.get("class") == "area")
    assert overview is not None
    assert overview.count("z") > 10
    assert "Drawn without streets" not in outline.text


def test_damaged_net_is_said(make_folder: Callable[..., Path], rows: Any, tmp_path: Path) -> None:
    broken = tmp_path / "broken.net.xml"
    broken.write_text("<net><edge")
    text = _read(make_folder([rows.episode(0)], options={"net": str(broken)})).text
    assert f"Drawn without streets: {broken}: " in text


def test_odd_names_are_escaped(make_folder: Callable[..., Path], rows: Any) -> None:
    odd = '<script>alert("ü")</script>'
    episodes = [rows.struck(0, odd, scene=odd, fault_reason=odd)]
    states = rows.drive(0, odd, 90.0, 101.0, 5.0) + rows.drive(0, 'e"><b>', 85.0, 101.0, 10.0, target=True)
    outline = _read(make_folder(episodes, states, options={"target": odd, "net": odd}))
    scripts = [attrs.get("id") for tag, attrs in outline.tags if tag == "script"]
    assert scripts == ["index", "e0", None, None]  # data, uPlot and our own
    assert odd in outline.text
    assert any(odd in label for label in outline.values("aria-label"))


def test_same_run_same_bytes(two_episodes: Path) -> None:
    first = write_report(two_episodes).read_bytes()
    assert write_report(two_episodes).read_bytes() == first


def test_offline_and_labelled(two_episodes: Path) -> None:
    outline = _read(two_episodes)
    assert [v for name in ("src", "srcset", "data", "action") for v in outline.values(name)] == []
    assert all(link.startswith("#") for link in outline.values("href"))
    ids = outline.values("id")
    assert len(ids) == len(set(ids))
    assert {link[1:] for link in outline.values("href")} <= set(ids)
    assert set(outline.values("aria-labelledby")) <= set(ids)
    assert "link" not in [tag for tag, _ in outline.tags]
    assert all(
        attrs.get("role") == "img" and attrs.get("aria-label") for t, attrs in outline.tags if t == "svg"
    )


def test_empty_run(make_folder: Callable[..., Path]) -> None:
    text = _read(make_folder([], options={"episodes": 5})).text
    assert "0 of 5 episodes" in text
    assert "The run has no finished episode." in text


def test_interrupted_run(make_folder: Callable[..., Path], rows: Any) -> None:
    folder = make_folder([rows.episode(0)], options={"episodes": 5})
    (folder / "parts").mkdir()
    text = _read(folder).text
    assert "1 of 5 episodes" in text
    assert "The run was interrupted" in text


def test_a_log_of_fewer_scenes_was_not_interrupted(make_folder: Callable[..., Path], rows: Any) -> None:
    text = _read(make_folder([rows.episode(0)], options={"episodes": 5})).text
    assert "1 of 5 episodes" in text
    assert "interrupted" not in text


def test_the_player_of_an_episode_tells_of_it_alone(make_folder: Callable[..., Path], rows: Any) -> None:
    """Beside a failed one that has a row, and one that failed before it had one."""
    failed = rows.episode(1, end="failed", failure_kind="plan_refused", failure_message="NaN.")
    states = rows.drive(0, "ego", 85.0, 101.0, 10.0, target=True)
    folder = make_folder([rows.episode(0), failed], states, options={"episodes": 3})
    lost = [{"episode": k, "kind": "plan_refused", "message": "NaN.", "log_tail": ""} for k in (1, 2)]
    pq.write_table(pa.Table.from_pylist(lost), folder / "failures.parquet")
    assert "66.7 % 2 of 3 episodes" in _read(folder).text
    text = Outline(load(folder).episode(0).player().page).text
    assert "0.0 % 0 of 1 episodes" in text
    assert "1 of 3 episodes" not in text
    assert "Run run-1: 1 episode of" in text


def test_failure_without_states(make_folder: Callable[..., Path], rows: Any) -> None:
    failed = rows.episode(0, end="failed", failure_kind="plan_refused", failure_message="The plan holds NaN.")
    text = _read(make_folder([failed])).text
    assert "Episode 0: failed (plan refused)" in text
    assert "The plan holds NaN." in text
    assert "there is nothing to draw" in text
    assert "100.0 % 1 of 1 episodes" in text


def test_an_episode_of_one_instant_has_a_picture_and_no_charts(
    make_folder: Callable[..., Path], rows: Any
) -> None:
    failed = rows.episode(
        0, end="failed", duration_s=0.0, failure_kind="planner_error", failure_message="No."
    )
    states = rows.drive(0, "ego", 85.0, 101.0, 10.0, target=True, steps=1)
    outline = _read(make_folder([failed], states))
    assert "It ended at its first instant: there is nothing to chart." in outline.text
    classes = [attrs.get("class") for _, attrs in outline.tags]
    assert "map" in classes
    assert "chart" not in classes


def test_collisions_of_others_are_listed(make_folder: Callable[..., Path], rows: Any) -> None:
    states = rows.drive(0, "ego", 85.0, 101.0, 10.0, target=True)
    crash = {"episode": 0, "time_s": 1.2, "first": "a", "second": "b", "with_target": False, "initial": False}
    crash |= {"first_speed_mps": 1.0, "impact_x_m": 90.0, "impact_y_m": 105.0}
    outline = _read(make_folder([rows.episode(0)], states, [crash]))
    assert "1.2 s: a and b, background among itself" in outline.text
    assert sum(attrs.get("class") == "impact small" for _, attrs in outline.tags) == 1


def test_target_that_leaves_the_road(make_folder: Callable[..., Path], rows: Any) -> None:
    left = rows.struck(0, None, collision_type="off_road", closing_speed_mps=None)
    text = _read(make_folder([left], rows.drive(0, "ego", 85.0, 101.0, 10.0, target=True))).text
    assert "Episode 0: off road at 3.0 s" in text


def test_size_is_bounded(
    make_folder: Callable[..., Path], rows: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    episodes = [rows.struck(k, closing_speed_mps=float(k)) for k in range(4)]
    states = [row for k in range(4) for row in rows.drive(k, "ego", 85.0, 101.0, 10.0, target=True)]
    folder = make_folder(episodes, states)
    whole = _read(folder)
    assert sum(tag == "article" for tag, _ in whole.tags) == 4
    monkeypatch.setattr(sections, "PICTURE_BYTES", 20_000)
    cut = _read(folder)
    kept = [attrs["id"] for tag, attrs in cut.tags if tag == "article"]
    assert kept == ["episode-3", "episode-2"][: len(kept)]
    assert 1 <= len(kept) < 4
    assert f"{4 - len(kept)} more would make this file too large" in cut.text
    assert sum(tag == "tr" for tag, _ in cut.tags) == sum(tag == "tr" for tag, _ in whole.tags)


@pytest.mark.parametrize("name", ["run.toml", "episodes.parquet", "collisions.parquet", "states.parquet"])
def test_missing_or_damaged_file_is_one_sentence(two_episodes: Path, name: str) -> None:
    (two_episodes / name).write_bytes(b"\xff no such format")
    with pytest.raises(FileError, match=re.escape(name)):
        write_report(two_episodes)
    (two_episodes / name).unlink()
    with pytest.raises(FileError, match=f"{re.escape(name)}: is missing; give the folder of a finished run"):
        write_report(two_episodes)


def test_a_file_is_no_folder_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("none")
    with pytest.raises(FileError, match=r"run\.toml: is missing; give the folder of a finished run or sweep"):
        write_report(tmp_path / "notes.txt")


def test_table_of_another_version(two_episodes: Path) -> None:
    (two_episodes / "states.parquet").write_bytes((two_episodes / "episodes.parquet").read_bytes())
    with pytest.raises(FileError, match="lacks the columns step, time_s, agent"):
        write_report(two_episodes)


def test_rules_broken_without_a_contact_stand_beside_those_of_collisions(
    make_folder: Callable[..., Path], rows: Any
) -> None:
    alone = rows.episode(0) | {
        "offences": "red_light",
        "offences_text": "The target ran a red light (1.0 s).",
    }
    page = write_report(make_folder([alone], rows.drive(0, "ego", 0.0, 10.0, 5.0, target=True))).read_text(
        "utf-8"
    )
    assert "<td>target, without a contact: red light</td>" in page
    assert "<p>The target ran a red light (1.0 s).</p>" in page, "in the printed part, too, as in the player"


@pytest.mark.parametrize(
    ("verdict", "offences", "said"),
    [
        ("'b' broke no rule; the target ran a red light.", "The target ran a red light (1.0 s).", False),
        ("'b' broke no rule; the target ran a red light.", "The target reversed (2.0 s).", True),
        ("… the target ran a red light.", "The target ran a red light (1.0 s), reversed (2.0 s).", True),
        (None, "The target ran a red light (1.0 s).", True),
        ("… the target ran a red light.", None, False),
    ],
)
def test_a_rule_that_the_verdict_names_is_not_named_again(
    verdict: str | None, offences: str | None, said: bool
) -> None:
    told = further_offences({"verdict": verdict, "offences_text": offences})
    assert told == (offences if said else "")


def test_numbers_as_text() -> None:
    assert number(-1.26, 1, "m") == "−1.3\u00a0m"
    assert number(-0.04) == "0.0"
    assert number(None) == number(float("nan")) == percent(None) == "–"
    assert percent(0.125) == "12.5\u00a0%"


def test_whose_modules_a_repetition_needs() -> None:
    assert own_modules({"target": "mine.fast:Planner", "background": "sumo"}) == ["mine/"]
    assert own_modules({"target": "exec:python server.py", "background": "other:Policy"}) == ["other.py"]
    assert (
        own_modules({"target": "__main__:Planner", "background": "advdiff_sumo.traffic.replay:Replay"}) == []
    )
