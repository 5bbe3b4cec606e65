"""The page in Chromium: its numbers are those of the log, nothing of a log is markup, and it finds a flight again."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pinocchio
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
from onboard.page.plan import read
from onboard.page.recorded import Recorded
from onboard.page.state import BODY
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.page.browser import Tab
from tests.page.made import MARKUP, SECOND, START, Rings, flight
from tests.page.served import served
from tests.recording.logs import make_log

pytestmark = pytest.mark.realtime
CARD = "document.querySelector('.answer[data-name=\"m_payload\"]')"


def test_numbers_on_the_page_are_those_of_the_log_at_every_time(tab: Tab, made_log: Path) -> None:
    found, rows = Recorded(LogReader(made_log)), LogReader(made_log).read("quantity")
    rows = rows[rows["name"] == b"m_payload"]
    steps = found.about()["steps"]
    with served(found) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
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
    with served(Recorded(LogReader(made_log)), plan=read(tmp_path / "plan.json")) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
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
    with served(Recorded(LogReader(tmp_path / "lost.mcap"))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait(f"{CARD}?.querySelector('.number').innerText.trim() === 'no longer determined'")
        tab.run("document.getElementById('slider').value = 0; document.getElementById('slider').oninput()")
        tab.wait(f"{CARD}.querySelector('.number').innerText.trim() === 'not determined yet'")


def test_a_device_that_is_silent_after_the_flight_is_no_alarm(tab: Tab, tmp_path: Path) -> None:
    made = {batch.channel: batch.rows for batch in flight()}
    event = np.zeros(3, records.EVENT)
    event["host_ns"], event["code"] = START + np.array([0, 7, 8]) * SECOND, [b"mode", b"note", b"mode"]
    event["text"] = [b"run: ", b"", b"stopped: "]
    with LogWriter.create(tmp_path / "over.mcap", durable=False) as writer:
        for name, rows in (
            ("health_stream", made["health_stream"]),
            ("joint_1", made["joint_1"][:400]),
            ("event", event),
        ):
            writer.register(name, rows.dtype)
            writer.write(name, rows)
    found = Recorded(LogReader(tmp_path / "over.mcap"))
    with served(found) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        rate = "document.querySelector('#devices tr')?.children[1]"
        tab.wait(f"{rate}?.innerText === '0.00 / 100' && {rate}.className === 'n'")
        before = found.about()["steps"].index(7.0)
        tab.run(f"document.getElementById('slider').value = {before}; document.getElementById('slider').oninput()")
        tab.wait(f"{rate}.innerText === '0.00 / 100' && {rate}.className === 'n bad'")


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
    make_log(tmp_path / "long.mcap", {"quantity": rows, "event": event})
    with served(Recorded(LogReader(tmp_path / "long.mcap"))) as one:
        tab.screen(360, 740)
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait("document.querySelectorAll('.answer[data-name]').length === 40")
        assert tab.run("document.querySelectorAll('#reasons li').length") == 3
        assert tab.text("#further-count") == "37 more reasons"
        assert tab.run("document.querySelectorAll('#further-reasons li').length") == 37
        assert tab.run("document.documentElement.scrollWidth") <= 360
        assert tab.run("document.querySelector('.held').getBoundingClientRect().top") < 1.4 * 740


def test_reasons_that_come_and_go_move_nothing(tab: Tab, made_log: Path) -> None:
    top = "document.querySelector('.held').getBoundingClientRect().top"
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait(f"{CARD} !== null")
        said = tab.run("document.getElementById('reasons').replaceChildren()") or tab.run(top)
        told = tab.run(
            "for (let i = 0; i < 4; i++) reasons.append(document.createElement('li'), 'a reason')"
        ) or tab.run(top)
    assert said == told > 0


def test_numbers_carry_their_power_of_ten(tab: Tab, made_log: Path) -> None:
    """The value too, which stands in a line of its own."""
    cases = [(0.003027, 2.8e-5), (3.027e-7, 2.8e-9), (-2.5e8, 1e6), (5.0132, 0.037), (0.0, 1.2e-9)]
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
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


def test_what_is_drawn_of_the_payload_is_what_the_log_says(tab: Tab, tmp_path: Path, rng: np.random.Generator) -> None:
    """Each point of its ellipsoid, and the ends of its centre's intervals, in base axes; the log's newest angles."""
    folder = packaged("dymaflex").parent
    urdf = (folder / "dymaflex.urdf").read_text()
    model = VehicleModel(urdf, VehicleSpec(BaseKind.FIXED, "base"))
    mass, semi, centre = 5.0, np.array([0.05, 0.1, 0.2]), np.array([0.03, -0.02, 0.08])
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = turn @ np.diag(mass / 5.0 * (np.sum(semi**2) - semi**2)) @ turn.T
    quantity, row = np.zeros(10, channels.QUANTITY), np.zeros(2, channels.row_dtype(1, len(model.joints)))
    quantity["host_ns"], quantity["supported"], row["host_ns"] = START, 1, [START, START + SECOND]
    quantity["name"] = [f"{kind}_payload".encode() for kind in BODY]
    quantity["unit"] = [b"kg", *[b"m"] * 3, *[b"kg m^2"] * 6]
    quantity["value"] = [mass, *centre, *(inertia[at] for at in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))]
    half = rng.uniform(0.01, 0.05, 10)
    quantity["low"], quantity["high"] = quantity["value"] - half, quantity["value"] + half
    row["joint_rad"] = rng.uniform(-2.0, 2.0, row["joint_rad"].shape)
    with LogWriter.create(tmp_path / "held.mcap", durable=False) as writer:
        for path in (folder / "vehicle.toml", folder / "dymaflex.urdf"):
            writer.attach(path.name, "text/plain", path.read_bytes())
        writer.add_metadata("flight", {"vehicle": "dymaflex", "vehicle_file": "vehicle.toml"})
        for name, content in (("quantity", quantity), ("row", row)):
            writer.register(name, content.dtype)
            writer.write(name, content)
    found = Recorded(LogReader(tmp_path / "held.mcap"))
    script = f"""Promise.all([import('./arm.js'), fetch('flight'), fetch('frame/{len(found) - 1}')]).then(
        async ([{{Arm, links}}, flight, frame]) => {{
            const arm = new Arm(document.getElementById('arm')), {{joints, held}} = await frame.json(), lines = [];
            arm.begin((await flight.json()).arm);
            arm.show(joints, held, false);
            arm.body(links(arm.tree, arm.now()), (...line) => lines.push(line), name => name);
            return lines;
        }})"""
    with served(found) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        drawn = tab.run(script)
    data, full = model.model.createData(), pinocchio.neutral(model.model)
    full[[joint.q_index for joint in model.joints]] = row["joint_rad"][1]
    pinocchio.framesForwardKinematics(model.model, data, full)
    pose = data.oMf[model.model.getFrameId("payload")]
    cross = np.array([line[:2] for line in drawn if line[2] == "true"])  # (3, 2, 3)
    ends = np.stack([centre - np.diag(half[1:4]), centre + np.diag(half[1:4])], axis=1)
    np.testing.assert_allclose(cross, [[pose.act(end) for end in pair] for pair in ends], atol=2e-5)
    rings = np.array([line[:2] for line in drawn if line[2] == "b"])
    assert len(rings) == 3 * 24
    own = (np.array([pose.actInv(point) for point in rings.reshape(-1, 3)]) - centre) @ turn / semi
    np.testing.assert_allclose(np.linalg.norm(own, axis=1), 1.0, atol=1e-3)
    np.testing.assert_allclose(np.abs(own).max(axis=0), 1.0, atol=1e-3)  # from end to end of each axis


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


@pytest.mark.parametrize("name", ["dymaflex", "rocksat", "workshop"])
def test_no_part_of_the_arm_is_cut_off(tab: Tab, made_log: Path, name: str, rng: np.random.Generator) -> None:
    """Whatever its joints, and from wherever it is looked at."""
    tree = tree_of({"vehicle.urdf": next(packaged(name).parent.glob("*.urdf")).read_bytes()})
    assert tree is not None
    count = sum(joint["q"] is not None for joint in tree["joints"])
    poses = rng.uniform(-1.5, 1.5, (20, count + 2)).tolist()
    script = f"""import('./arm.js').then(({{Arm}}) => {{
        const arm = new Arm(document.getElementById('arm'));
        arm.begin({json.dumps(tree)});
        return {json.dumps(poses)}.map(([turn, tilt, ...q]) => {{
            arm.show(q, [], false);
            arm.turn = 2 * turn; arm.tilt = tilt; arm.draw();
            const {{width, height}} = arm.canvas;
            const pen = new OffscreenCanvas(width, height).getContext('2d', {{willReadFrequently: true}});
            pen.drawImage(arm.canvas, 0, 0);
            const inked = (...box) => pen.getImageData(...box).data.some(value => value);
            const edges = [[0, 0, width, 1], [0, height - 1, width, 1], [0, 0, 1, height], [width - 1, 0, 1, height]];
            return [inked(0, 0, width, height), edges.some(edge => inked(...edge))];
        }});
    }})"""
    with served(Recorded(LogReader(made_log))) as one:
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait("!document.getElementById('arm').hidden")
        assert tab.run(script) == [[True, False]] * len(poses)


def test_a_signal_below_the_screen_is_drawn_when_it_is_scrolled_to(tab: Tab, made_log: Path) -> None:
    with served(Recorded(LogReader(made_log))) as one:
        tab.screen(360, 740)
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait(f"{CARD} !== null && document.getElementById('signal').value === 'joint_1'")
        tab.run("new Promise(later => setTimeout(later, 500)).then(() => 1)")
        tab.run("document.getElementById('signals').scrollIntoView()")
        tab.wait("!!document.querySelector('.bands path')?.getAttribute('d')")


def test_a_signal_of_a_log_is_zoomed(tab: Tab, made_log: Path) -> None:
    """What the plot spans, by its ends and by its path, for buttons, keys and a drag."""
    ends = "[...document.querySelectorAll('#signal-from, #signal-to')].map(one => parseFloat(one.textContent))"
    scale = "[...document.querySelectorAll('#signal-high, #signal-low')].map(one => parseFloat(one.textContent))"

    def click(*names: str) -> None:
        for name in names:
            tab.run(f"document.getElementById('signal-{name}').click()")

    with served(Recorded(LogReader(made_log))) as one:
        tab.screen(1280, 2000)
        tab.open(f"http://127.0.0.1:{one.port}/")
        tab.wait("!!document.querySelector('.bands path')")
        assert tab.run(ends) == [0, 10]
        click("in")
        assert tab.run(ends) == [2.5, 7.5]
        assert tab.run(scale) == pytest.approx([0.75, 0.25], abs=0.05)  # the joint turns 0.1 rad a second
        click("later", "later")
        assert tab.run(ends) == [5, 10]
        click("in", "out", "earlier", "earlier", "earlier")
        assert tab.run(ends) == [0, 5]
        tab.run("document.querySelector('.plot svg').onkeydown({key: '0', preventDefault() {}})")
        assert tab.run(ends) == [0, 10]
        tab.drag(".plot svg", 0.2, 0.4)
        assert tab.run(ends) == pytest.approx([2, 4], abs=0.02)
        click("all")
        assert tab.run(ends) == [0, 10]
        assert tab.run("document.getElementById('signal-pause').hidden")


def test_signals_of_a_flight_pause_and_go_on(tab: Tab, rings: Rings) -> None:
    end = "parseFloat(document.getElementById('signal-to').textContent)"
    batches = {batch.channel: batch for batch in flight()}
    joint = batches["joint_1"].rows
    with process.serving(rings.log, ":0") as url:
        tab.screen(1280, 2000)
        tab.open(url)
        rings.push([records.Batch("joint_1", joint[:400])])
        tab.wait(f"{end} === 3.95")
        tab.run("document.getElementById('signal-pause').click()")
        rings.push([records.Batch("joint_1", joint[400:800])])
        tab.wait("document.querySelector('#devices tr')?.dataset.rows === '800'")
        tab.run("new Promise(later => setTimeout(later, 2500)).then(() => 1)")
        assert tab.run(end) == 3.95
        assert tab.text("#signal-pause") == "resume"
        tab.run("document.getElementById('signal-pause').click()")
        tab.wait(f"{end} === 7.95")
        path = tab.run("document.querySelector('.bands path').getAttribute('d')")
    assert path.count("M") == 1
    assert path.count("L") == 2 * 160 - 1  # a step of 50 ms each, none twice


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
