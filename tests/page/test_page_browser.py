"""The page in Chromium: its numbers are those of the log, nothing of a log is markup, and it finds a flight again."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drivers import records
from onboard import channels
from onboard.page import process
from onboard.page.follow import LogFrames
from onboard.page.process import read
from onboard.recording.reader import LogReader
from tests.page.browser import CARD, Tab, opened
from tests.page.made import MARKUP, SECOND, START, Rings, flight
from tests.recording.logs import make_log

pytestmark = pytest.mark.realtime


def test_numbers_on_the_page_are_those_of_the_log_at_every_time(tab: Tab, made_log: Path) -> None:
    found, rows = LogFrames(LogReader(made_log)), LogReader(made_log).read("quantity")
    rows = rows[rows["name"] == b"m_payload"]
    steps = found.about()["steps"]
    with opened(tab, found):
        tab.wait(f"{CARD} && document.getElementById('time').textContent === 'T+ 10.0 s'")
        processes = (
            "[...document.querySelectorAll('#processes-box tr')].map(row => row.innerText.split('\\t').slice(0, 2))"
        )
        assert tab.run(processes) == [["process", "acquisition"], ["CPU %", "12.5"], ["PSS MB", "17"]]
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


def test_the_plan_s_interval_stands_beside_the_answer_s(tab: Tab, made_log: Path, tmp_path: Path) -> None:
    wanted = [
        {"name": "m_payload", "unit": "kg", "sigma": 0.0125},
        {"name": "c_x_payload", "unit": "m", "sigma": np.inf},
    ]
    (tmp_path / "plan.json").write_text(json.dumps({"expected": wanted}))
    with opened(tab, LogFrames(LogReader(made_log)), read(tmp_path / "plan.json")):
        tab.wait(f"{CARD} !== null")
        assert tab.run(f"{CARD}.querySelector('.plan').innerText") == "plan \u00b1 0.024 kg"
        assert tab.run("document.querySelectorAll('.plan:not([hidden])').length") == 1
        slider = "document.getElementById('slider')"
        tab.run(f"{slider}.value = 0; {slider}.oninput()")
        tab.wait(f"{CARD}.innerText.includes('not determined yet')")
        assert tab.run(f"{CARD}.querySelector('.plan').hidden")


def test_an_answer_that_is_lost_again_is_not_one_that_never_was(tab: Tab, tmp_path: Path) -> None:
    rows = np.zeros(3, channels.QUANTITY)
    rows["host_ns"], rows["supported"], rows["level"] = START + np.arange(3) * SECOND, [0, 1, 0], [1, 0, 1]
    rows["name"], rows["unit"], rows["value"], rows["high"] = b"m_payload", b"kg", 1.0, 2.0
    make_log(tmp_path / "lost.mcap", {"quantity": rows})
    with opened(tab, LogFrames(LogReader(tmp_path / "lost.mcap"))):
        tab.wait(f"{CARD}?.querySelector('.number').innerText.trim() === 'no longer determined'")
        tab.run("document.getElementById('slider').value = 0; document.getElementById('slider').oninput()")
        tab.wait(f"{CARD}.querySelector('.number').innerText.trim() === 'not determined yet'")


def test_a_device_that_is_silent_after_the_flight_is_no_alarm(tab: Tab, tmp_path: Path) -> None:
    made = {batch.channel: batch.rows for batch in flight()}
    event = np.zeros(3, records.EVENT)
    event["host_ns"], event["code"] = START + np.array([0, 7, 8]) * SECOND, [b"mode", b"note", b"mode"]
    event["text"] = [b"run: ", b"", b"stopped: "]
    rows = {"health_stream": made["health_stream"], "joint_1": made["joint_1"][:400], "event": event}
    make_log(tmp_path / "over.mcap", rows)
    found = LogFrames(LogReader(tmp_path / "over.mcap"))
    with opened(tab, found):
        rate = "document.querySelector('#devices tr')?.children[1]"
        tab.wait(f"{rate}?.innerText === '0.00 / 100' && {rate}.className === 'n'")
        before = found.about()["steps"].index(7.0)
        tab.run(f"document.getElementById('slider').value = {before}; document.getElementById('slider').oninput()")
        tab.wait(f"{rate}.innerText === '0.00 / 100' && {rate}.className === 'n bad'")


def test_nothing_of_a_log_is_markup(tab: Tab, made_log: Path) -> None:
    with opened(tab, LogFrames(LogReader(made_log))):
        tab.wait("document.querySelectorAll('#events li').length === 3")
        assert MARKUP.decode() in tab.text("#events")
        assert "phase <b>1</b>" in tab.text("#phase")
        assert tab.run("document.querySelectorAll('main img, main b, main script').length") == 0
        assert tab.run("document.querySelectorAll('.answer[data-name]').length") == 3


def test_events_are_found(tab: Tab, made_log: Path) -> None:
    with opened(tab, LogFrames(LogReader(made_log))):
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
    tab.screen(*size, scheme)
    with opened(tab, LogFrames(LogReader(made_log))):
        tab.wait(f"{CARD} !== null")
        assert tab.run("document.documentElement.scrollWidth") <= size[0]
        foot = f"{CARD}.getBoundingClientRect().bottom"
        assert tab.run(foot) < size[1]  # the verdict and the mass are seen without scrolling
        tab.shot(tmp_path / "page.png")
        grey = np.asarray(Image.open(tmp_path / "page.png").convert("L"))
        assert (np.median(grey) > 230) == (scheme == "light")
        assert (np.median(grey) < 50) == (scheme == "dark")


def test_many_reasons_and_long_texts_leave_room_for_what_is_held(tab: Tab, tmp_path: Path) -> None:
    rows, event = np.zeros(40, channels.QUANTITY), np.zeros(1, records.EVENT)
    rows["host_ns"], rows["unit"], rows["value"], rows["supported"], rows["level"] = START, b"kg", 3e5, 1, 1
    rows["name"] = [b"m_[red]<b>%02d%s" % (number, b"W" * 20) for number in range(40)]
    rows["why"] = [b"reason %d %s" % (number, b"W" * 100) for number in range(40)]
    event["host_ns"], event["code"], event["text"] = START, b"phase", b"W" * 160
    make_log(tmp_path / "long.mcap", {"quantity": rows, "event": event})
    tab.screen(360, 740)
    with opened(tab, LogFrames(LogReader(tmp_path / "long.mcap"))):
        tab.wait("document.querySelectorAll('.answer[data-name]').length === 40")
        assert tab.run("document.querySelectorAll('#reasons li').length") == 3
        assert tab.text("#further-count") == "37 more reasons"
        assert tab.run("document.querySelectorAll('#further-reasons li').length") == 37
        assert tab.run("document.documentElement.scrollWidth") <= 360
        assert tab.run("document.querySelector('.held').getBoundingClientRect().top") < 1.4 * 740


def test_reasons_that_come_and_go_move_nothing(tab: Tab, made_log: Path) -> None:
    top = "document.querySelector('.held').getBoundingClientRect().top"
    with opened(tab, LogFrames(LogReader(made_log))):
        tab.wait(f"{CARD} !== null")
        said = tab.run("document.getElementById('reasons').replaceChildren()") or tab.run(top)
        told = tab.run(
            "for (let i = 0; i < 4; i++) reasons.append(document.createElement('li'), 'a reason')"
        ) or tab.run(top)
    assert said == told > 0


def test_numbers_carry_their_power_of_ten(tab: Tab, made_log: Path) -> None:
    """The value too, which stands in a line of its own."""
    cases = [(0.003027, 2.8e-5), (3.027e-7, 2.8e-9), (-2.5e8, 1e6), (5.0132, 0.037), (0.0, 1.2e-9)]
    with opened(tab, LogFrames(LogReader(made_log))):
        script = (
            f"import('./format.js').then(({{withInterval}}) => {json.dumps(cases)}.map(one => withInterval(...one)))"
        )
        told = tab.run(script)
    assert told == [
        ["0.003027", "\u00b1 0.000028"],
        ["3.027\u00d710\u207b\u2077", "\u00b1 0.028\u00d710\u207b\u2077"],
        ["-2.500\u00d710\u2078", "\u00b1 0.010\u00d710\u2078"],
        ["5.013", "\u00b1 0.037"],
        ["0.0\u00d710\u207b\u2079", "\u00b1 1.2\u00d710\u207b\u2079"],
    ]


def test_it_follows_a_flight_and_finds_the_next_one(tab: Tab, rings: Rings) -> None:
    with process.serving(rings.log, ":0") as url:
        port = int(url.rstrip("/").rpartition(":")[2])
        tab.open(url)
        tab.wait("document.getElementById('link').textContent === 'waiting for the flight to begin'")
        rings.push(flight())
        tab.wait("document.getElementById('link').textContent === 'live'")
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
    with opened(tab, LogFrames(LogReader(made_log))):
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


def test_it_comes_back_after_a_page_process_that_was_killed(tab: Tab, rings: Rings) -> None:
    rings.push(flight())
    command = [sys.executable, "-m", "onboard.page", str(rings.log)]
    port = 0
    for _ in range(2):
        with subprocess.Popen([*command, f":{port}"], stdout=subprocess.PIPE, text=True) as running:
            assert running.stdout is not None
            url = running.stdout.readline().split()[1]
            if not port:
                port = int(url.rstrip("/").rpartition(":")[2])
                tab.open(url)
            tab.wait("document.getElementById('link').textContent === 'live'")
            assert "5.020" in tab.run(f"{CARD}.innerText")
            running.kill()
        tab.wait("document.getElementById('link').textContent === 'no connection: trying again'")
        style = "getComputedStyle(document.querySelector('main'))"
        assert tab.run(f"[{style}.filter, {style}.opacity]") == ["grayscale(1)", "1"]  # old, and as legible as before
        tab.run("new Promise(later => setTimeout(later, 3000)).then(() => 1)")  # tried again, in vain
