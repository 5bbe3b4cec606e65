"""A flight that asks for its motions: the library, the choice, and the loop in virtual time."""

from dataclasses import replace
from xml.etree import ElementTree as ET

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from onboard import channels, config
from onboard.channels import Act
from onboard.cli import main
from onboard.config.segments import Library, read, to_bytes
from onboard.flight.estimate.asking import Asking
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.log.tables import truth
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.online import Change
from onboard.recording.reader import LogReader
from tests.ground.before.planning.test_planning import SCENARIO

LIMITS = "base_rate_rad_s = 1.2\njoint.joint_1.rate = 2.0\njoint.joint_2.rate = 2.0\n"


@pytest.fixture(scope="module")
def flyer(tmp_path_factory):
    """A free-flyer with two joints and a cell at the wrist, and a scenario with little in it."""
    directory = tmp_path_factory.mktemp("flyer")
    asked = ["init", str(directory / "mine"), "--base", "free", "--joints", "2", "--load-cell", "cia404"]
    assert main(asked) == 0
    file = directory / "mine" / "vehicle.toml"
    exact = "[estimation.imu_prior]\ngyro_cross_axis = 0\naccelerometer_cross_axis = 0 "  # so its simulated IMU is
    text = file.read_text().replace("[estimation.imu_prior]", exact)
    for rate, slower in (
        ("sample_rate_hz = 1000", "sample_rate_hz = 250"),
        ("poll_period_ms = 10", "poll_period_ms = 40"),
    ):
        text = text.replace(rate, slower)
    file.write_text(text)
    with file.open("a") as more:
        more.write("\n[estimation.useful]\nmoment = 0.3\n")  # so little is learned here in few segments
    (directory / "over.toml").write_text(SCENARIO)
    return directory


@pytest.fixture(scope="module")
def library(flyer):
    """By the command line; two payloads, few steps of the search."""
    (flyer / "limits.toml").write_text(LIMITS)
    asked = ["plan", str(flyer / "mine" / "vehicle.toml"), "--scenario", str(flyer / "over.toml"), "--segments"]
    few = ["--starts", "1", "--iterations", "1", "--masses", "8,0.5", "--seconds", "4"]
    assert main([*asked, *few, "--limits", str(flyer / "limits.toml"), "-o", str(flyer / "lib")]) == 0
    return flyer / "lib" / "segments.npz"


@pytest.fixture(scope="module")
def flown(flyer, library):
    """A flight until the mass is known to 6 %, the moments of inertia to 16 %; its log."""
    log = flyer / "asked.mcap"
    (flyer / "heavy.toml").write_text(f"payload.mass_kg = [3.0, 3.0]\nrelease.rate_rad_s = 0.02\n{SCENARIO}")
    asked = ["hil", str(flyer / "mine" / "vehicle.toml"), "--scenario", str(flyer / "heavy.toml"), "--most", "60"]
    asked += ["--hand-over", str(flyer / "payload.urdf")]
    main([*asked, "--until", "mass 6 %, inertia 16 %", "--segments", str(library), "--log", str(log)])
    return log


def events(log, code):
    return [row for row in LogReader(log).read("event_estimation") if row["code"].decode() == code]


def test_a_flight_asks_until_its_goal_is_met_and_ends(flown):
    requests = LogReader(flown).read("request")
    assert requests["act"].tolist() == [Act.SEGMENT] * (len(requests) - 1) + [Act.MET]
    assert len(requests) >= 3
    np.testing.assert_array_equal(requests["number"], np.arange(len(requests)))
    quantity = LogReader(flown).read("quantity")
    mass = quantity[quantity["name"] == b"m_payload"][-1]
    assert 0.5 * (mass["high"] - mass["low"]) < 0.101 * mass["value"]
    assert LogReader(flown).read("tick")["host_ns"][-1] - requests["host_ns"][-1] < 3_000_000_000
    assert "segments" in events(flown, "goal_met")[0]["text"].decode()


def test_the_arm_plays_what_was_asked_and_nothing_else(flown, library):
    requests, rows = LogReader(flown).read("request"), LogReader(flown).read("row")
    asked = truth.read(flown)["asked"]
    names = [row["segment"].decode() for row in requests[:-1]]
    own, at_s = read(library), 1e-9 * rows["vehicle_ns"]
    assert [one["segment"] for one in asked] == names
    first = rows["joint_rad"][(at_s < 1e-9 * requests["host_ns"][0]) & (rows["gate"] == 0).all(axis=1)]
    assert np.abs(first - own.posture).max() < 5e-3  # it waits in the posture
    played = 0
    for row in requests[:-1]:
        k = own.names.index(row["segment"].decode())
        after_s = at_s - 1e-9 * row["host_ns"]
        if after_s[-1] < own.durations_s[k] + 0.5:
            continue  # the flight was over before it
        seen = rows["joint_rad"][(after_s > 0.0) & (after_s < own.durations_s[k] + 0.5)]
        seen = seen[np.isfinite(seen).all(axis=1)]
        np.testing.assert_allclose(np.ptp(seen, axis=0), np.ptp(own.q[k], axis=0), rtol=0.1, atol=5e-3)
        played += 1
    assert played >= 2


def test_what_was_asked_is_replayed_from_the_log_alone(flown, capsys):
    assert main(["replay", str(flown)]) == 0
    assert "request" in capsys.readouterr().out


def test_the_payload_is_handed_over_as_it_was_last_answered(flown, flyer):
    [handed] = events(flown, "handed_over")
    said = ET.parse(flyer / "payload.urdf").getroot().find("identified")
    quantity = LogReader(flown).read("quantity")
    answers = quantity[quantity["host_ns"] == int(said.get("host_ns"))]
    for one in said:
        row = answers[answers["name"] == one.get("name").encode()][0]
        assert row["level"] == 0
        assert [float(one.get(field)) for field in ("value", "low", "high")] == [row["value"], row["low"], row["high"]]
    assert len(said) == 10
    assert handed["host_ns"] <= int(said.get("host_ns")) <= quantity["host_ns"][-1]
    withdrawn = len(events(flown, "hand_over_withdrawn"))
    assert len(events(flown, "handed_over")) == 1 + withdrawn


@pytest.mark.campaign  # of the choice: test_a_release_while_a_segment_is_played, below
def test_what_is_let_go_in_mid_segment_is_asked_about_no_more(flyer, library):
    """The segment is played to its end; nothing is held then, and nothing is asked for."""
    held = SCENARIO[SCENARIO.index("[[sequence]]") :]  # from the start, as the vehicle file says
    (flyer / "lost.toml").write_text(
        f"capture = false\npayload.mass_kg = [3.0, 3.0]\nrelease.rate_rad_s = 0.02\nejection.at_s = 12.0\n{held}"
    )
    log, own = flyer / "lost.mcap", str(flyer / "mine" / "vehicle.toml")
    asked = ["hil", own, "--scenario", str(flyer / "lost.toml"), "--most", "16", "--log", str(log)]
    main([*asked, "--until", "mass 0.1 %", "--segments", str(library)])
    start_ns = truth.read(log)["start_ns"]
    [gone] = events(log, "ejection")
    assert 0.0 < 1e-9 * (gone["host_ns"] - start_ns) - 12.0 < 3.0
    requests = LogReader(log).read("request")
    segments = requests[requests["act"] == Act.SEGMENT]
    assert len(segments) >= 2
    assert segments["host_ns"].max() < gone["host_ns"]
    assert events(log, "goal_waits")[-1]["host_ns"] >= gone["host_ns"]
    assert not events(log, "goal_met")


def test_a_library_comes_back_as_it_was_written(library, tmp_path):
    own = read(library)
    (tmp_path / "again.npz").write_bytes(to_bytes(own))
    again = read(tmp_path / "again.npz")
    for name in Library.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(own, name))
    assert own.masses.tolist() == [0.5, 8.0]
    heaviest = [k for k, name in enumerate(own.names) if name.endswith("_8kg")]
    assert len(heaviest) == 4
    assert (own.excess[heaviest] <= 0.0).all()  # safe with every payload
    assert (own.base_rate[heaviest] <= 1.2).all()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (
            lambda file: {**file, "q": file["q"] + np.linspace(0, 1, file["q"].shape[1])[:, None]},
            "postures at begin and end",
        ),
        (lambda file: {**file, "base_rate": file["base_rate"][:1]}, "base_rate cannot be"),
        (lambda file: {**file, "roots": file["roots"] * np.nan}, "roots cannot be"),
        (lambda file: {name: part for name, part in file.items() if name != "q"}, "heft plan --segments"),
        (lambda file: {**file, "format": np.array(99)}, "another version"),
        (lambda file: {**file, "cyclic": file["cyclic"][:0, :0]}, "sigma cannot be"),
        (lambda file: {**file, "names": np.array("a")}, "names.* cannot be"),
        (lambda file: {**file, "unknowns": np.arange(len(file["unknowns"]))}, "unknowns cannot be"),
        (lambda file: {**file, "joints": np.array([2**22], np.uint32).view("U1")}, "joints holds text that is none"),
    ],
)
def test_a_damaged_library_is_refused(library, tmp_path, spoil, said):
    with np.load(library) as file:
        np.savez(tmp_path / "bad.npz", **spoil(dict(file)))
    with pytest.raises(config.ConfigError, match=said):
        read(tmp_path / "bad.npz")
    (tmp_path / "text.npz").write_text("nothing")
    with pytest.raises(config.ConfigError, match="cannot be read"):
        read(tmp_path / "text.npz")


@pytest.mark.parametrize(
    ("goal", "said"), [("colour 1 %", "the quantities are mass"), ("mass one %", "write WHAT NUMBER UNIT")]
)
def test_a_goal_that_is_none_is_refused(flyer, library, capsys, goal, said):
    asked = ["hil", str(flyer / "mine" / "vehicle.toml"), "--until", goal, "--segments", str(library)]
    assert main([*asked, "--scenario", str(flyer / "over.toml"), "--log", str(flyer / "none.mcap")]) == 2
    assert said in capsys.readouterr().err
    assert not (flyer / "none.mcap").exists()


def test_until_without_segments_is_refused(flyer, capsys):
    assert main(["hil", str(flyer / "mine" / "vehicle.toml"), "--until", "mass 1 %"]) == 2
    assert "heft plan --segments writes" in capsys.readouterr().err


class TestLimits:
    """Which segments are asked for, as the mass becomes known."""

    @pytest.fixture
    def asking(self, flown, tmp_path):
        vehicle = vehicle_of(LogReader(flown), tmp_path)
        estimator = Estimator(vehicle)
        assert estimator.outputs["request"] == channels.REQUEST
        return Asking(vehicle, vehicle.segments, estimator.online, estimator.model), estimator.online

    def step(self, asking, time_s, rate=0.0, moving=0.0):
        own, online = asking
        joints = np.stack([own.library.posture + moving, np.full(2, moving)])
        return own.step(round(1e9 * time_s), time_s, joints, np.array([rate, 0.0, 0.0]), online)

    def test_before_anything_is_known_the_motion_is_safe_with_every_payload(self, asking):
        asking[1].ekf.held = True
        request, said = self.step(asking, 1.0)
        library = asking[0].library
        k = library.names.index(request.rows["segment"][0].decode())
        assert library.excess[k].max() <= 0.0
        assert library.base_rate[k].max() <= library.most
        assert said.rows["code"][0] == b"segment_asked"
        assert self.step(asking, 2.0) == []  # while it is played

    def test_while_nothing_is_known_to_be_held_a_small_motion_is_asked_for_from_time_to_time(self, asking):
        own, online = asking
        online.ekf.held = False
        made = {time_s: said for time_s in range(1, 120) if (said := self.step(asking, float(time_s)))}
        *probes, (last,) = made.values()
        assert [request.rows["act"][0] for request, _ in probes] == [Act.SEGMENT] * 5
        assert "caught at rest" in probes[0][1].rows["text"][0].decode()
        k = own.library.names.index(probes[0][0].rows["segment"][0].decode())
        assert own.library.base_rate[k].max() <= own.library.most
        assert np.diff(list(made)).min() >= 10  # rests of probe_s, and what is played between
        assert next(iter(made)) == 11
        assert last.rows["code"][0] == b"goal_waits"
        online.ekf.held = True
        online.ekf.changes.append(Change("capture", 121.0, 121.0, np.nan))
        again, _ = self.step(asking, 122.0)
        assert again.rows["act"][0] == Act.SEGMENT

    def test_a_rest_before_a_small_motion_counts_from_when_the_arm_stood_in_its_posture(self, asking):
        asking[1].ekf.held = False
        assert [self.step(asking, time_s, moving=0.2) for time_s in (1.0, 20.0)] == [[], []]
        assert self.step(asking, 29.0) == []
        assert len(self.step(asking, 30.5)) == 2

    def test_probe_s_of_zero_moves_nothing(self, asking):
        asking[1].ekf.held, asking[0].probe_s = False, 0.0
        assert [self.step(asking, time_s) for time_s in (1.0, 60.0)] == [[], []]

    def test_a_release_while_a_segment_is_played_is_followed_by_nothing_and_a_capture_by_small_motions(self, asking):
        _, online = asking
        online.ekf.held = True
        first, _ = self.step(asking, 1.0)
        online.ekf.held = False
        online.ekf.changes.append(Change("ejection", 2.0, 2.0, np.nan))
        [said] = self.step(asking, 2.0, moving=0.2)
        assert said.rows["code"][0] == b"goal_waits"
        assert [self.step(asking, time_s) for time_s in (3.0, 60.0)] == [[], []]
        online.ekf.held = True
        online.ekf.changes.append(Change("capture", 61.0, 61.0, np.nan))
        assert self.step(asking, 61.0, moving=0.2) == []  # the arm does not rest
        again, _ = self.step(asking, 62.0)
        assert again.rows["segment"][0] == first.rows["segment"][0]
        assert again.rows["ratio"][0] == first.rows["ratio"][0]  # all of what was known is gone

    def test_a_base_that_turns_too_fast_by_itself_is_left_alone_and_the_event_says_why(self, asking):
        asking[1].ekf.held = True
        request, _, why = self.step(asking, 1.0, rate=1.19)
        assert request.rows["act"][0] == Act.GIVEN_UP
        assert "the base would turn at" in why.rows["text"][0].decode()
        assert self.step(asking, 2.0) == []

    @settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(
        seed=st.integers(0, 2**32 - 1),
        low=st.floats(0.0, 9.0),
        wide=st.sampled_from([0.0, 0.01, 1.0, 20.0]),
        turning=st.sampled_from([0.0, 0.1, 1.0]),
    )
    def test_no_segment_is_asked_for_that_breaks_a_limit_with_a_mass_that_is_possible(
        self, asking, seed, low, wide, turning
    ):
        own, rng = asking[0], np.random.default_rng(seed)
        whole = own.library
        over = rng.choice([-0.3, 0.0, 1e-9, 0.01, 0.3], whole.excess.shape, p=[0.5, 0.2, 0.1, 0.1, 0.1])
        rates = rng.uniform(0.0, 1.2, whole.base_rate.shape)
        own.library = replace(whole, excess=over, base_rate=rates, most=1.2)
        own.since_change, own.ratios = 0, []
        known = own._known(asking[1].ekf, asking[1].estimate(), turning)._replace(masses_kg=(low, low + wide))
        request, *_ = own._ask(0, 0.0, known, 5.0, solved=False)
        own.library = whole
        first = max(int((whole.masses <= low).sum()) - 1, 0)  # the masses on both sides of all that it may weigh
        last = min(int((whole.masses < low + wide).sum()), len(whole.masses) - 1)
        both = slice(min(first, last), last + 1)
        keeps = (over[:, both] <= 0.0).all(axis=1) & (rates[:, both] + turning <= 1.2).all(axis=1)
        if request.rows["act"][0] == Act.SEGMENT:
            assert keeps[whole.names.index(request.rows["segment"][0].decode())]
        else:
            assert not keeps.any()

    @pytest.mark.parametrize("settled", [True, False])
    def test_motions_in_a_window_that_is_not_explained_yet_are_not_taken_to_tell_nothing(
        self, asking, monkeypatch, settled
    ):
        own, online = asking
        ekf = online.ekf
        ekf.held, ekf.covariance = True, own.prior.copy()
        ekf.state = np.zeros(len(own.prior))
        ekf.state[PAYLOAD] = [0.7, 0.0, 0.0, 0.0, 1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]
        monkeypatch.setattr(type(ekf), "settled", lambda _: settled)
        said = []
        for time_s in np.arange(1.0, 60.0):
            own.moved = True
            said += [batch.rows["code"][0] for batch in self.step(asking, time_s) if batch.channel == "event"]
        assert (b"goal_given_up" in said) == settled
        assert said.count(b"segment_asked") == 3 if settled else said.count(b"segment_asked") > 6

    @pytest.mark.filterwarnings("error")
    def test_a_state_that_is_no_motion_is_not_linearised_about(self, asking):
        own, online = asking
        ekf = online.ekf
        ekf.held, ekf.covariance = True, own.prior.copy()
        ekf.state = np.zeros(len(own.prior))
        ekf.state[PAYLOAD] = [0.1, 90.0, 90.0, 90.0, 1e-9, 0.0, 1e-9, 0.0, 0.0, 1e-9]
        ekf.state[RATE] = 1e6
        assert len(self.step(asking, 1.0)) == 2
        assert own.own == [None] * len(own.own)

    def test_an_arm_that_does_not_move_is_noticed(self, asking):
        asking[1].ekf.held = True
        acts = [made[0].rows["act"][0] for time_s in np.arange(1.0, 60.0) if (made := self.step(asking, time_s))]
        assert acts == [Act.SEGMENT] * 3 + [Act.GIVEN_UP]

    @pytest.mark.parametrize(("off_rad", "asks"), [(0.03, True), (0.08, False)])
    def test_an_arm_in_the_posture_is_as_near_to_it_as_a_servo_holds_it(self, asking, off_rad, asks):
        own, online = asking
        online.ekf.held = True
        joints = np.stack([own.library.posture + off_rad, np.zeros(2)])
        assert bool(own.step(10**9, 1.0, joints, np.zeros(3), online)) is asks

    def test_an_arm_that_does_not_come_back_from_a_motion_is_given_up_as_long_after_it_as_it_lasts(self, asking):
        own, online = asking
        online.ekf.held = True
        self.step(asking, 1.0)
        request, _ = self.step(asking, 70.0)
        lasts_s = 1.0 + own.library.durations_s[own.library.names.index(request.rows["segment"][0].decode())]
        said = [time_s for time_s in np.arange(71.0, 150.0) if self.step(asking, time_s, moving=0.2)]
        assert len(said) == 1
        assert 0.0 < said[0] - (70.0 + 2.0 * lasts_s) <= 1.0

    def test_an_arm_that_is_elsewhere_is_waited_for_and_then_given_up(self, asking):
        asking[1].ekf.held = True
        acts = {
            time_s: made[0].rows["act"][0] for time_s in range(1, 80) if (made := self.step(asking, time_s, 0.0, 0.2))
        }
        assert acts == {62: Act.GIVEN_UP}
