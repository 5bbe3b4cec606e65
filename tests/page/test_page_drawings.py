"""What the page draws, in Chromium: the arm, what it holds, and the devices' signals."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from drivers import records
from onboard import channels
from onboard.config.loader import packaged
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.skeleton import skeleton
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.page import process
from onboard.page.arm import tree_of
from onboard.page.follow import LogFrames
from onboard.page.state import BODY
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.page.browser import CARD, Tab, opened
from tests.page.made import SECOND, START, Rings, flight

pytestmark = pytest.mark.realtime


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
    with opened(tab, LogFrames(LogReader(made_log))):
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
    with opened(tab, LogFrames(LogReader(made_log))):
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
    found = LogFrames(LogReader(tmp_path / "held.mcap"))
    script = f"""Promise.all([import('./arm.js'), fetch('flight'), fetch('frame/{len(found) - 1}')]).then(
        async ([{{Arm, links}}, flight, frame]) => {{
            const arm = new Arm(document.getElementById('arm')), {{joints, held}} = await frame.json(), lines = [];
            arm.begin((await flight.json()).arm);
            arm.show(joints, held, false);
            arm.body(links(arm.tree, arm.now()), (...line) => lines.push(line), name => name);
            return lines;
        }})"""
    with opened(tab, found):
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
    with opened(tab, LogFrames(LogReader(made_log))):
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
    with opened(tab, LogFrames(LogReader(made_log))):
        tab.wait("!document.getElementById('arm').hidden")
        assert tab.run(script) == [[True, False]] * len(poses)


def test_a_signal_below_the_screen_is_drawn_when_it_is_scrolled_to(tab: Tab, made_log: Path) -> None:
    tab.screen(360, 740)
    with opened(tab, LogFrames(LogReader(made_log))):
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

    tab.screen(1280, 2000)
    with opened(tab, LogFrames(LogReader(made_log))):
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


def test_whole_times_stand_under_the_plot(tab: Tab, made_log: Path, tmp_path: Path) -> None:
    cases = [[0.0, 10.0, 5], [3.31, 3.62, 4], [55.0, 190.0, 6], [0.0, 7200.0, 8], [5.0, 5.0, 4], [0.0, 200000.0, 3]]
    with opened(tab, LogFrames(LogReader(made_log))):
        found = tab.run(f"import('./format.js').then(({{ticks}}) => {json.dumps(cases)}.map(one => ticks(...one)))")
        times = [[round(t, 6) for t, _ in one] for one in found]
        words = [[text for _, text in one] for one in found]
        assert times[0] == [0, 2, 4, 6, 8, 10]
        assert words[0] == ["0 s", "2 s", "4 s", "6 s", "8 s", "10 s"]
        assert words[1] == ["3.4 s", "3.5 s", "3.6 s"]
        assert words[2] == ["1:00", "1:30", "2:00", "2:30", "3:00"]
        assert times[3] == [900 * k for k in range(9)]
        assert words[3][-1] == "2:00:00"
        assert times[4] in ([], [5])
        assert all(len(one) <= case[2] + 1 for one, case in zip(found, cases, strict=True))
        for width in (1280, 390):
            tab.screen(width, 800)
            tab.run("document.getElementById('signals').scrollIntoView()")
            count = "document.querySelectorAll('#signal-times span').length"
            tab.wait(f"{count} > 2 && {count} * 64 < innerWidth")
            shown = tab.run("""[...document.querySelectorAll('#signal-times span')].map(one => {
                const at = one.getBoundingClientRect();
                const box = document.querySelector('#signals svg').getBoundingClientRect();
                const share = (at.left + at.width / 2 - box.left) / box.width;
                return [parseFloat(one.textContent), share, at.left, at.right]; })""")
            assert all(abs(share - seconds / 10.0) < 0.01 for seconds, share, *_ in shown), shown
            assert all(b[2] - a[3] > 4 for a, b in pairwise(shown))  # none over another
            tab.shot(tmp_path / f"ticks_{width}.png")
