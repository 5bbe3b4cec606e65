"""The page in Chromium: its numbers are those of the log, nothing of a log is markup, and it finds a flight again."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from onboard.page import process
from onboard.page.recorded import Recorded
from onboard.recording.reader import LogReader
from tests.page.browser import BROWSER, Tab, browser
from tests.page.made import MARKUP, SECOND, START, Rings, flight
from tests.page.served import served

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(BROWSER is None, reason="no browser to look with: apt install chromium"),
]
CARD = "document.querySelector('.answer[data-name=\"m_payload\"]')"


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browser(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture(autouse=True)
def _silent(tab: Tab) -> Iterator[None]:
    """No error in the console; a server that is gone is told there by the browser itself."""
    tab.said.clear()
    tab.screen(1280, 800)
    yield
    tab.run("1")
    gone = "net::ERR_CONNECTION_REFUSED"
    assert [said for said in tab.said if gone not in str(said) and "net::ERR_INCOMPLETE" not in str(said)] == []
    tab.open("about:blank")


def test_numbers_on_the_page_are_those_of_the_log_at_every_time(tab: Tab, made_log: Path) -> None:
    found, rows = Recorded(LogReader(made_log)), LogReader(made_log).read("quantity")
    rows = rows[rows["name"] == b"m_payload"]
    steps = found.about()["steps"]
    with served(found) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait(f"{CARD} && document.getElementById('time').textContent === 'T+ 10.0 s'")
        for number in (len(steps) - 1, 0, len(steps) // 2, 3):
            last = rows[rows["host_ns"] <= START + round(steps[number] * SECOND)][-1]
            slider = "document.getElementById('slider')"
            tab.run(f"{slider}.value = {number}; {slider}.oninput()")
            tab.wait(f"document.getElementById('time').textContent === 'T+ {steps[number]:.1f} s'")
            shown = tab.run(f"({{...{CARD}.querySelector('.number').dataset}})")
            values = {key: shown[key] for key in ("value", "low", "high")}
            if not last["supported"]:
                assert set(values.values()) == {""}
                assert "not determined yet" in tab.run(f"{CARD}.innerText")
                continue
            assert {key: float(value) for key, value in values.items()} == {key: last[key] for key in values}
            printed = tab.run(f"{CARD}.querySelector('.number').innerText")
            value, _, half, unit = printed.split()
            assert unit == "kg"
            assert float(half) == pytest.approx(0.5 * (last["high"] - last["low"]), rel=0.05)
            assert float(value) == pytest.approx(last["value"], abs=0.05 * float(half))
            assert len(value.partition(".")[2]) == len(half.partition(".")[2])
            assert tab.run(f"{CARD}.querySelector('.level').textContent") == ("weak" if last["level"] else "good")
        assert tab.text("#word") == "NO-GO"
        assert tab.text('#devices tr[data-name="joint_1"]').split()[0] == "joint_1"


def test_nothing_of_a_log_is_markup(tab: Tab, made_log: Path) -> None:
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait("document.querySelectorAll('#events li').length === 3")
        assert MARKUP.decode() in tab.text("#events")
        assert "phase <b>1</b>" in tab.text("#phase")
        assert tab.run("document.querySelectorAll('main img, main b, main script').length") == 0
        assert tab.run("document.querySelectorAll('.answer').length") == 3


def test_events_are_found(tab: Tab, made_log: Path) -> None:
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait("document.querySelectorAll('#events li').length === 3")
        search = "document.getElementById('search')"
        for words, count in (("ALL answered", 1), ("estimation", 1), ("nothing like it", 0), ("[", 0), ("", 3)):
            tab.run(f"{search}.value = {words!r}; {search}.oninput()")
            assert tab.run("document.querySelectorAll('#events li').length") == count
        tab.run("document.getElementById('warnings').click()")
        assert tab.run("document.querySelectorAll('#events li').length") == 1


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1280, 800), (360, 740)])
def test_on_a_screen(tab: Tab, made_log: Path, tmp_path: Path, size: tuple[int, int], scheme: str) -> None:
    with served(Recorded(LogReader(made_log))) as one:
        tab.screen(*size, scheme)
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait(f"{CARD} !== null")
        assert tab.run("document.documentElement.scrollWidth") <= size[0]
        foot = f"{CARD}.getBoundingClientRect().bottom"
        assert tab.run(foot) < size[1]  # the verdict and the mass are seen without scrolling
        tab.shot(tmp_path / "page.png")
        grey = np.asarray(Image.open(tmp_path / "page.png").convert("L"))
        assert (np.median(grey) > 230) == (scheme == "light")
        assert (np.median(grey) < 50) == (scheme == "dark")


def test_what_has_no_name_for_who_does_not_see(tab: Tab, made_log: Path) -> None:
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait(f"{CARD} !== null")
        unnamed = """[...document.querySelectorAll('input, select, button, svg, section')].filter(one =>
            !one.labels?.length && !one.getAttribute('aria-label') && !one.getAttribute('aria-labelledby')
            && !one.textContent.trim() && !one.closest('[hidden]')).map(one => one.outerHTML)"""
        assert tab.run(unnamed) == []
        assert tab.run("document.documentElement.lang") == "en"
        assert tab.run("document.querySelectorAll('h1').length") == 1


def test_it_follows_a_flight_and_finds_the_next_one(tab: Tab, rings: Rings) -> None:
    with process.serving(rings.log, ":0") as url:
        port = int(url.rstrip("/").rpartition(":")[2])
        tab.open(url)
        tab.wait("document.getElementById('link').textContent === 'live'")
        rings.push(flight())
        tab.wait(f"{CARD} && {CARD}.querySelector('.number').dataset.value === '5.0198378161508'")
        tab.wait("document.querySelectorAll('#events li').length === 3")
        assert tab.run("document.getElementById('player').hidden")
    tab.wait("document.getElementById('link').textContent !== 'live'")
    assert "5.020" in tab.run(f"{CARD}.innerText")  # the last numbers stay
    time.sleep(0.5)
    with process.serving(rings.log, f":{port}"):
        tab.wait("document.getElementById('link').textContent === 'live'")
        tab.wait("document.querySelectorAll('#events li').length === 3")


def test_an_hour_does_not_grow_in_the_browser(tab: Tab, made_log: Path) -> None:
    """A course of four points a second keeps its length, and its ends."""
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait(f"{CARD} !== null")
        script = """import('./course.js').then(({Course}) => {
            const course = new Course();
            for (let i = 0; i < 14400; i++) course.add([i / 4, 1, 0, 2]);
            return [course.points.length, course.points[0][0], course.points.at(-1)[0]];
        })"""
        count, first, last = tab.run(script)
    assert 200 <= count <= 400
    assert first == 0
    assert last > 3580
