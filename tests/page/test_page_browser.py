"""The page in Chromium: its numbers are those of the log, nothing of a log is markup, and it finds a flight again."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drivers import records
from onboard import channels
from onboard.config.loader import packaged
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.skeleton import skeleton
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.page import process
from onboard.page.arm import tree_of
from onboard.page.recorded import Recorded
from onboard.page.state import BODY
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
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
    """No error in the console; of a server that has ended the browser itself tells there (``net::``)."""
    tab.said.clear()
    tab.screen(1280, 800)
    yield
    tab.run("1")
    assert [said for said in tab.said if "net::ERR_" not in str(said)] == []
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
        assert tab.run("document.querySelectorAll('.answer[data-name]').length") == 3


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


def test_many_reasons_and_long_texts_leave_room_for_what_is_held(tab: Tab, tmp_path: Path) -> None:
    rows, event = np.zeros(40, channels.QUANTITY), np.zeros(1, records.EVENT)
    rows["host_ns"], rows["unit"], rows["value"], rows["supported"], rows["level"] = START, b"kg", 3e5, 1, 1
    rows["name"] = [b"m_[red]<b>%02d%s" % (number, b"W" * 20) for number in range(40)]
    rows["why"] = [b"reason %d %s" % (number, b"W" * 100) for number in range(40)]
    event["host_ns"], event["code"], event["text"] = START, b"phase", b"W" * 160
    with LogWriter.create(tmp_path / "long.mcap", durable=False) as writer:
        for name, content in (("quantity", rows), ("event", event)):
            writer.register(name, content.dtype)
            writer.write(name, content)
    with served(Recorded(LogReader(tmp_path / "long.mcap"))) as one:
        tab.screen(360, 740)
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait("document.querySelectorAll('.answer[data-name]').length === 40")
        assert tab.run("document.querySelectorAll('#reasons li').length") == 4
        assert tab.text("#further-count") == "36 more reasons"
        assert tab.run("document.querySelectorAll('#further-reasons li').length") == 36
        assert tab.run("document.documentElement.scrollWidth") <= 360
        assert tab.run("document.querySelector('.held').getBoundingClientRect().top") < 1.4 * 740


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


def turned() -> str:
    """A URDF of joints that turn about axes in general directions, and slide."""
    joints = ""
    for number, kind in enumerate(("revolute", "prismatic", "fixed", "revolute", "revolute")):
        joints += (
            f'<link name="link_{number + 1}"/><joint name="joint_{number}" type="{kind}"><parent link="link_{number}"/>'
            f'<child link="link_{number + 1}"/><origin xyz="0.{number} -0.2 0.3" rpy="0.4 -0.{number + 5} 1"/>'
            f'<axis xyz="{number - 1} 2 0.5"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    return f'<robot name="turned"><link name="link_0"/>{joints}</robot>'


@pytest.mark.parametrize("name", ["dymaflex", "dymaflex_wheels", "rocksat", "workshop", "turned"])
def test_the_arm_is_where_the_model_has_it(tab: Tab, made_log: Path, name: str, rng: np.random.Generator) -> None:
    text = turned() if name == "turned" else next(packaged(name).parent.glob("*.urdf")).read_text()
    tree = tree_of({"vehicle.urdf": text.encode()})
    assert tree is not None
    model = VehicleModel(text, VehicleSpec(BaseKind.FIXED, tree["root"]))
    q = rng.uniform(-1.0, 1.0, len(model.joints))
    points = skeleton(model, q[None])
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        script = f"import('./arm.js').then(({{links}}) => links({json.dumps(tree)}, {json.dumps(q.tolist())}))"
        found = tab.run(script)
    child = {joint["name"]: joint["child"] for joint in tree["joints"]}
    compared = [
        (found[child.get(key, key)]["p"], at) for key, at in zip(points.names, points.p_m[0], strict=True) if key
    ]
    assert len(compared) > len(model.joints)
    for mine, theirs in compared:
        np.testing.assert_allclose(mine, theirs, atol=1e-9)


def test_the_ellipsoid_has_the_inertia_that_is_held(tab: Tab, made_log: Path, rng: np.random.Generator) -> None:
    """A uniform ellipsoid of semi-axes a, b, c: m/5 (b^2 + c^2), and so on, turned."""
    mass, semi = 3.0, np.array([0.1, 0.2, 0.35])
    R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    tensor = R @ np.diag(mass / 5.0 * (np.sum(semi**2) - semi**2)) @ R.T
    numbers = [mass, 0.01, 0.02, -0.03, *(tensor[at] for at in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))]
    held = [
        {"name": f"{kind}_x", "value": value, "low": value - 0.5, "high": value + 0.5, "supported": True}
        for kind, value in zip(BODY, numbers, strict=True)
    ]
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        call = f"import('./arm.js').then(({{bodyOf}}) => bodyOf({json.dumps(held)}, 'x'))"
        body = tab.run(call)
        assert tab.run(call.replace("true", "false")) is None
    assert sorted(body["semi"]) == pytest.approx(sorted(semi))
    axes = np.array(body["axes"])
    np.testing.assert_allclose(axes @ np.diag(np.square(body["semi"])) @ axes.T, R @ np.diag(semi**2) @ R.T, atol=1e-9)
    assert body["centre"] == [0.01, 0.02, -0.03]
    assert body["half"] == pytest.approx([0.5] * 3)


def test_the_arm_is_drawn_and_turns(tab: Tab, made_log: Path) -> None:
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait(f"{CARD} !== null")
        picture = "document.querySelector('#arm canvas').toDataURL()"
        tab.wait("!document.getElementById('arm').hidden && document.querySelector('#arm canvas').width > 100")
        tab.run("new Promise(requestAnimationFrame).then(() => new Promise(requestAnimationFrame)).then(() => 1)")
        before = tab.run(picture)
        tab.run("document.querySelector('#arm canvas').onkeydown({key: 'ArrowLeft', preventDefault() {}})")
        tab.wait(f"{picture} !== {before!r}")


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
        tab.run("new Promise(later => setTimeout(later, 3000)).then(() => 1)")  # tried again, in vain
