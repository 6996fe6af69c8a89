"""The page in Debian's Chromium, driven by Playwright: it plays, seeks, filters and prints, and raises no error."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pytest

from advdiff_sumo.report.folder import FinishedRun
from advdiff_sumo.report.page import write_report
from tests.hang_guard import HANG_S
from tests.metrics.encounter_folder import encounter_folder
from tests.report.conftest import drive, episode, job, write_folder, write_sweep

_CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
#: Chromium notes that we look at the canvas often.
_OWN_READING = "willReadFrequently"
_SIZES = [(1360, 900), (420, 860)]

playwright = pytest.importorskip(
    "playwright.sync_api", reason="no Playwright here: pip install -c constraints.txt -e '.[dev]'"
)
pytestmark = pytest.mark.skipif(_CHROMIUM is None, reason="no Chromium here: apt-get install chromium")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=_CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def report(sweep_folder: Path) -> Path:
    return write_report(sweep_folder)


@pytest.fixture
def look(browser: Any) -> Iterator[Callable[..., Any]]:
    """Return a function that opens a page with its player ready; at the end nothing may have gone wrong."""
    troubles: list[str] = []
    contexts: list[Any] = []

    def open_page(
        path: Path, size: tuple[int, int] = _SIZES[0], scheme: str = "light", anchor: str = ""
    ) -> Any:
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, offline=True
        )
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(1e3 * HANG_S)
        page.on("console", lambda message: _OWN_READING in message.text or troubles.append(message.text))
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on(
            "request",
            lambda request: request.url.partition("#")[0] != path.as_uri() and troubles.append(request.url),
        )
        page.goto(path.as_uri() + anchor)
        page.wait_for_selector("#player[data-episode]", timeout=1e3 * HANG_S)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert troubles == []


def _time(page: Any) -> float:
    return float(page.evaluate("document.getElementById('player').player.time"))


def _until(page: Any, condition: str) -> None:
    """Wait for *condition*; Playwright's own waiting evaluates text, which the page's policy forbids."""
    until = monotonic() + HANG_S
    while monotonic() < until:
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    pytest.fail(f"never came: {condition}")


def _shown(page: Any) -> int:
    return int(page.get_attribute("#player", "data-episode"))


@pytest.mark.parametrize("size", _SIZES)
def test_worst_episode_stands_at_its_contact(
    look: Callable[..., Any], report: Path, size: tuple[int, int]
) -> None:
    page = look(report, size)
    assert _shown(page) == 1
    assert _time(page) == 3.0
    assert page.inner_text("#player-title") == "Episode 1: rear end striking at 3.0\u00a0s"
    assert page.inner_text("[data-part=verdict]").startswith("At fault: target. It drove into the rear.")
    assert "advdiff-sumo replay" in page.inner_text("[data-part=command]")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate("document.querySelectorAll('.plots canvas').length") == 5


@pytest.mark.parametrize("size", _SIZES)
def test_long_names_fit_the_window(look: Callable[..., Any], tmp_path: Path, size: tuple[int, int]) -> None:
    name = f"{'planner_of_the_highway_team' * 3}.version_3:HighwayPlanner"
    episodes = [job(episode(0), "IDM", "sumo", "a"), job(episode(1), name, "sumo", "a")]
    states = [row for number in (0, 1) for row in drive(number, "ego", 405.0, 410.0, 10.0, target=True)]
    page = look(write_report(write_sweep(tmp_path / "sweep", episodes, states)), size)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    for cell in ("#episodes tbody tr:nth-child(2) td", ".matrix tbody tr:nth-child(2) th"):
        assert page.locator(cell).first.bounding_box()["width"] < 0.8 * size[0]


def test_an_episode_of_one_instant_has_no_charts(look: Callable[..., Any], tmp_path: Path) -> None:
    failed = episode(0, end="failed", duration_s=0.0, failure_kind="planner_error", failure_message="No.")
    states = drive(0, "ego", 85.0, 101.0, 10.0, target=True, steps=1)
    page = look(write_report(write_folder(tmp_path / "run", [failed], states)))
    assert page.evaluate("document.querySelectorAll('.plots canvas').length") == 0
    assert "there is nothing to chart" in page.inner_text(".plots")


@pytest.mark.parametrize("size", _SIZES)
def test_plays_by_key_and_stops_at_the_end(
    look: Callable[..., Any], report: Path, size: tuple[int, int]
) -> None:
    page = look(report, size)
    page.focus("#player")
    page.select_option("[data-part=speed]", "4")
    page.keyboard.press("Home")
    assert _time(page) == 0.0
    page.keyboard.press(" ")
    _until(page, "document.getElementById('player').player.time > 0.5")
    _until(page, "!document.getElementById('player').player.playing")
    assert _time(page) == pytest.approx(3.0)
    assert page.inner_text("[data-part=clock]") == "3.0 / 3.0 s"


def test_keys_and_slider_keep_everything_in_step(look: Callable[..., Any], report: Path) -> None:
    page = look(report)
    page.focus("#player")
    for key, time in [
        ("Home", 0.0),
        ("ArrowRight", 0.1),
        ("Shift+ArrowRight", 1.1),
        ("c", 3.0),
        ("End", 3.0),
    ]:
        page.keyboard.press(key)
        assert _time(page) == pytest.approx(time)
    page.fill("[data-part=slider]", "1.5")
    assert _time(page) == pytest.approx(1.5)
    captions = page.eval_on_selector_all(".plots figcaption", "all => all.map((one) => one.textContent)")
    assert captions[0] == "Speed (m/s) target 10.0, collision partner 5.0"
    # bumpers are 20 − 1.5 · 5 − 5 = 7.5 m apart and close at 5 m/s
    assert captions[3:] == ["Time to collision (s) 1.5", "Gap to the nearest (m) 7.5"]
    lines = page.eval_on_selector_all(".plots .now", "all => all.map((one) => one.style.left)")
    assert lines == ["50%"] * 5
    words = page.inner_text("[data-part=words]")
    assert words == (
        "1.5 seconds, target 10.0 metres per second, time to collision 1.5 seconds, gap 7.5 metres"
    )


def test_positions_are_those_of_the_states(
    look: Callable[..., Any], report: Path, sweep_folder: Path
) -> None:
    decoded = look(report).evaluate(
        "() => { const { episode } = document.getElementById('player').player;"
        " return episode.agents.map(({ id, m, parts }) => [id, m, parts.map((p) =>"
        " [p.start, ...['x', 'y', 'yaw'].map((name) => Array.from(p[name]))])]).concat([episode.origin]); }"
    )
    origin = np.array(decoded.pop())
    states = FinishedRun.read(sweep_folder).states(1)
    assert states is not None
    assert [(name, moved) for name, moved, _ in decoded] == [("ego", 0), ("bv", 1)]
    for row, (_, _, parts) in enumerate(decoded):
        ((start, x, y, yaw),) = parts
        assert start == 0
        xy = np.stack((x, y), axis=-1) + origin
        assert np.abs(xy - states.tracks.xy_m[row]).max() <= 0.0051
        assert np.abs(np.array(yaw) - states.tracks.yaw_rad[row]).max() <= 0.0011


def test_natural_counterpart_is_drawn_until_it_is_switched_off(
    look: Callable[..., Any], report: Path
) -> None:
    page = look(report)
    pixels = "document.querySelector('#player canvas').toDataURL()"
    with_ghost = page.evaluate(pixels)
    page.click("[data-part=natural]")
    assert page.get_attribute("[data-part=natural]", "aria-pressed") == "false"
    assert page.evaluate(pixels) != with_ghost
    page.click("#episodes a[data-play='0']")  # natural traffic itself has no counterpart
    page.wait_for_selector("#player[data-episode='0']")
    assert page.is_disabled("[data-part=natural]")


def test_plans_are_drawn_as_they_are_at_the_moment(look: Callable[..., Any], report: Path) -> None:
    page = look(report)
    plans = page.evaluate(
        "() => document.getElementById('player').player.episode.agents.map(({ id, plans }) => [id, (plans || []).map("
        "(p) => [p.made, p.first, Array.from(p.x), Array.from(p.y)])])"
    )
    origin = page.evaluate("document.getElementById('player').player.episode.origin")
    assert plans[0] == ["ego", []]
    assert [made for made, *_ in plans[1][1]] == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    made, first, x, y = plans[1][1][2]
    assert (made, first) == (1.0, 1)
    assert [value + origin[0] for value in x] == pytest.approx([432.5 + 2.5 * k for k in range(6)])
    assert [value + origin[1] for value in y] == pytest.approx([411.0 + k for k in range(6)])
    pixels = "document.querySelector('#player canvas').toDataURL()"
    page.focus("#player")
    page.keyboard.press("Home")
    with_plans = page.evaluate(pixels)
    page.keyboard.press("t")
    assert page.get_attribute("[data-part=plans]", "aria-pressed") == "false"
    assert page.evaluate(pixels) != with_plans
    page.click("#episodes a[data-play='0']")  # SUMO's drivers do not tell theirs
    page.wait_for_selector("#player[data-episode='0']")
    assert page.is_disabled("[data-part=plans]")


def test_filters_and_goes_through_what_is_left(look: Callable[..., Any], report: Path) -> None:
    page = look(report)
    output = "#filter output"
    assert page.inner_text(output) == "4 of 4 episodes"
    page.select_option("#filter [name=policy]", "replay")
    assert page.inner_text(output) == "2 of 4 episodes"
    page.focus("#player")
    page.keyboard.press("n")
    page.wait_for_selector("#player[data-episode='3']")
    page.keyboard.press("n")  # there is no further one
    page.fill("#filter [name=text]", "rear end")
    assert page.inner_text(output) == "1 of 4 episodes"
    assert page.eval_on_selector_all("#episodes tbody tr:not([hidden])", "all => all.map((r) => r.id)") == [
        "row-1"
    ]
    page.click("#filter button[type=reset]")
    _until(page, "document.querySelector('#filter output').textContent === '4 of 4 episodes'")
    assert _shown(page) == 3


@pytest.mark.parametrize("size", _SIZES)
def test_sorts(look: Callable[..., Any], report: Path, size: tuple[int, int]) -> None:
    page = look(report, size)
    order = "all => all.map((cell) => Number(cell.dataset.v))"
    assert page.eval_on_selector_all("#episodes tbody th", order) == [1, 2, 3, 0]
    heading = page.locator("#episodes th button", has_text="Least TTC (s)")
    for expected in ([3, 0], [0, 3]):
        heading.click()
        found = page.eval_on_selector_all("#episodes tbody th", order)
        assert found[:2] == expected  # those without a time stay last
        assert set(found[2:]) == {1, 2}


def test_link_to_an_episode_opens_it(look: Callable[..., Any], report: Path) -> None:
    page = look(report, anchor="#play-3")
    assert _shown(page) == 3
    top = "document.getElementById('player').getBoundingClientRect().top"
    _until(page, f"Math.abs({top}) < 20")
    page.evaluate("scrollTo(0, 0)")
    page.evaluate("location.hash = '#play-1'")
    page.wait_for_selector("#player[data-episode='1']")
    _until(page, f"Math.abs({top}) < 20")


def test_page_without_an_episode_in_its_address_opens_at_its_head(
    look: Callable[..., Any], report: Path
) -> None:
    page = look(report)
    assert page.evaluate("[scrollY, location.hash]") == [0, ""]


def test_names_of_target_and_attacker_stand_off_both_boxes_at_the_contact(
    look: Callable[..., Any], report: Path
) -> None:
    page = look(report)
    page.focus("#player")
    page.keyboard.press("c")
    # both head east and are 5 m long, the attacker is ahead: its name is before its front, the target's behind its rear
    target, attacker, rear, front, y = page.evaluate(
        "() => { const { scene } = document.getElementById('player').player, { episode, view, labels } = scene;"
        " const part = (row) => episode.agents[row].parts[0], { target, attacker, origin } = episode;"
        " const px = (east) => scene.width / 2 + (origin[0] + east - view.x) * view.scale;"
        " return [labels[target], labels[attacker], px(part(target).x[30] - 2.5), px(part(attacker).x[30] + 2.5),"
        " scene.height / 2 - (origin[1] + part(target).y[30] - view.y) * view.scale]; }"
    )
    assert target[0] < rear - 10
    assert attacker[0] > front + 10
    assert [target[1], attacker[1]] == pytest.approx([y, y], abs=2.0)


def test_dark_colours_are_taken_along(look: Callable[..., Any], report: Path) -> None:
    corner = (
        "Array.from(document.querySelector('#player canvas').getContext('2d').getImageData(1, 1, 1, 1).data)"
    )
    light, dark = (sum(look(report, scheme=scheme).evaluate(corner)[:3]) for scheme in ("light", "dark"))
    assert light > 450 > 225 > dark


def test_print_has_the_pictures_and_not_the_player(look: Callable[..., Any], report: Path) -> None:
    page = look(report)
    page.emulate_media(media="print")
    assert not page.is_visible("#player")
    assert not page.is_visible("#filter")
    assert page.is_visible("#episode-1 svg.map")


def test_hundred_vehicles_are_drawn(look: Callable[..., Any], tmp_path: Path) -> None:
    states = drive(0, "ego", 300.0, 300.0, 10.0, target=True, steps=101)
    for k in range(99):
        states += drive(0, f"bv{k}", 250.0 + 3.0 * k, 260.0 + k % 25 * 4.0, 5.0 + k % 7, steps=101)
    folder = write_folder(tmp_path / "crowd", [episode(0)], states, options={"net": "downtown"})
    page = look(write_report(folder))
    drawn = page.evaluate(
        "() => { const { player } = document.getElementById('player'), { scene } = player, drawn = new Set();"
        " const inner = scene.drawAgent.bind(scene);"
        " scene.drawAgent = (row, at) => { drawn.add(row); inner(row, at); };"
        " for (let k = 0; k < 90; k++) player.seek(k / 9); return drawn.size; }"
    )
    assert drawn == 100


def test_the_careful_driver_and_the_filters_of_verdicts(
    look: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    page = look(write_report(encounter_folder(tmp_path_factory.mktemp("verdicts"))), anchor="#play-0")
    player = "document.getElementById('player').player"
    assert page.evaluate(f"{player}.episode.reference.agents[0].id") == "careful driver"
    assert page.text_content("#player .badge") == "valid failure"
    assert "careful driver" in (page.text_content("#player [data-part=charts]") or "")
    button = page.locator("[data-part=reference]")
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    page.keyboard.press("r")
    assert button.get_attribute("aria-pressed") == "true"
    for name, value, left in (("breach", "red_light", "1 of 3"), ("verdict", "critical", "1 of 3")):
        page.select_option(f"#filter [name={name}]", value)
        assert (page.text_content("#filter output") or "").startswith(left)
        page.select_option(f"#filter [name={name}]", "")
    page.select_option("#filter [name=kind]", "rear_end_striking")
    assert (page.text_content("#filter output") or "").startswith("1 of 3")
