"""What can be done on the page: only what is armed, here, by the page itself, confirmed and with a name."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from onboard import config
from onboard.channels import Order
from onboard.config.telemetry import Telemetry
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.store import rings as flight_rings
from onboard.flight.store.orders import PAGE, order_channels
from onboard.flight.supervise.orders import Orders
from onboard.page import process
from onboard.recording.format.texts import printable
from onboard.ring import RingReader
from tests.page.browser import Tab
from tests.page.made import Rings, flight
from tests.page.served import Reply, raw

pytestmark = pytest.mark.realtime
SCREENS = [(*size, scheme) for size in ((1280, 800), (390, 844)) for scheme in ("light", "dark")]


class Supervisor(threading.Thread):
    """Carries out the orders that come into a flight's rings."""

    def __init__(self, rings: Rings, armed: list[str]) -> None:
        super().__init__(daemon=True)
        vehicle = config.named("rocksat")
        telemetry = Telemetry(commands=armed)  # type: ignore[arg-type]
        vehicle = vehicle.model_copy(update={"file": vehicle.file.model_copy(update={"telemetry": telemetry})})
        writers = flight_rings.create(rings.directory, vehicle, order_channels(vehicle))
        self.said: list[str] = []
        publish = Publisher(writers, "_supervisor").publish
        self._orders = Orders(vehicle, rings.directory, lambda *one: self.said.append(one[-1]), publish)
        self.ends, self.over, self.paused = "", threading.Event(), False

    def run(self) -> None:
        while not self.over.is_set():
            if not self.paused:
                self.ends = self._orders.step(time.monotonic_ns()) or self.ends
            time.sleep(0.02)


@contextmanager
def acting(rings: Rings, armed: list[str], address: str = ":0") -> Iterator[tuple[str, Supervisor]]:
    """The page of a flight that arms ``armed``, and the flight's supervisor."""
    supervisor = Supervisor(rings, armed)
    rings.push(flight())
    supervisor.start()
    try:
        with process.serving(rings.log, address, None, armed) as url:
            yield url, supervisor
    finally:
        supervisor.over.set()
        supervisor.join()


def post(url: str, body: Any, *, path: str = "act", **changed: str | None) -> Reply:
    """A POST as the page sends it, with headers ``changed``."""
    port, token = url.removeprefix("http://127.0.0.1:").split("/")[:2]
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    given = {"Host": f"127.0.0.1:{port}", "Origin": f"http://127.0.0.1:{port}", "Content-Type": "application/json"}
    given |= {"Content-Length": str(len(data)), "Sec-Fetch-Site": "same-origin"}
    headers = given | {name.replace("_", "-"): value for name, value in changed.items()}
    lines = [f"{name}: {value}" for name, value in headers.items() if value is not None]
    where = f"/{token}/{path}" if token else f"/{path}"
    return raw(int(port), "\r\n".join([f"POST {where} HTTP/1.1", *lines, "", ""]).encode() + data)


def until(met: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + 30
    while not (found := met()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return found


MARK = {"act": "mark", "number": 7, "who": "Ada"}


def test_what_is_asked_is_handed_to_the_supervisor_with_a_name(rings: Rings) -> None:
    with acting(rings, ["mark", "stop", "span"]) as (url, supervisor):
        until(lambda: post(url, MARK).status == 200)
        reply = post(url, MARK | {"number": 8})
        assert (reply.status, json.loads(reply.body)) == (200, {"said": "mark 8 is in the log"})
        assert supervisor.said[-1] == "mark 8, asked by the page, Ada"
        assert supervisor.ends == ""
        reply = post(url, {"act": "stop", "who": " Grace "})
        assert (reply.status, json.loads(reply.body)["said"]) == (200, "the flight is being ended")
        assert supervisor.ends == "stop, asked by the page, Grace"
        supervisor.paused = True
        assert post(url, MARK).status == 504
        rows = RingReader(rings.directory / f"{PAGE}.ring").read()[0]
        assert [int(row["order"]) for row in rows[-3:]] == [Order.MARK, Order.STOP, Order.MARK]
        assert printable(rows[-2]["who"]) == "the page, Grace"


def test_what_is_not_of_the_page_itself_is_refused(rings: Rings) -> None:
    with acting(rings, ["mark"]) as (url, supervisor):
        until(lambda: post(url, MARK).status == 200)
        told = len(supervisor.said)
        bare = url.rpartition("/")[0].rpartition("/")[0]
        for reply, status in (
            (post(url, MARK, Origin=None), 403),
            (post(url, MARK, Origin="http://example.org"), 403),
            (post(url, MARK, Origin="null"), 403),
            (post(url, MARK, Sec_Fetch_Site="cross-site"), 403),
            (post(url, MARK, Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="navigate"), 403),
            (post(url, MARK, Content_Type="text/plain"), 415),
            (post(url, MARK, Content_Type="application/x-www-form-urlencoded"), 415),
            (post(url, MARK, Content_Type=None), 415),
            (post(url, MARK, Content_Length=None), 411),
            (post(url, MARK, Content_Length="-1"), 411),
            (post(url, MARK, Transfer_Encoding="chunked"), 411),
            (post(url, MARK, Content_Length="513"), 413),
            (post(url, MARK, path="flight"), 405),
            (post(url, MARK, path="live"), 405),
            (post(f"{bare}/{'x' * 22}/", MARK), 404),
            (post(url, {"act": "stop", "who": "Ada"}), 400),
            (post(url, {"act": "span", "who": "Ada"}), 400),
            (post(url, MARK | {"who": " "}), 400),
            (post(url, MARK | {"who": "a" * 41}), 400),
            (post(url, MARK | {"who": "a\nb"}), 400),
            (post(url, MARK | {"who": 5}), 400),
            (post(url, MARK | {"number": 65536}), 400),
            (post(url, MARK | {"number": True}), 400),
            (post(url, MARK | {"number": 1.5}), 400),
            (post(url, [MARK]), 400),
            (post(url, b"\xff\x00"), 400),
        ):
            assert reply.status == status, reply
        assert len(supervisor.said) == told


@pytest.mark.parametrize(("armed", "address"), [([], ":0"), (["span"], ":0")])
def test_without_an_armed_act_the_page_has_no_token_and_takes_no_post(
    rings: Rings, armed: list[str], address: str
) -> None:
    with acting(rings, armed, address) as (url, _):
        assert url.count("/") == 3
        assert post(url, MARK).status == 405


def test_on_a_network_nothing_can_be_done(rings: Rings) -> None:
    with acting(rings, ["mark", "stop"], "0.0.0.0:0") as (url, supervisor):
        here = f"http://127.0.0.1:{url.split(':')[2]}"
        assert post(here, MARK).status == 405
        assert supervisor.said == []


@pytest.mark.parametrize(("width", "height", "scheme"), SCREENS)
def test_in_a_browser_each_is_confirmed(
    tab: Tab, rings: Rings, tmp_path: Path, width: int, height: int, scheme: str
) -> None:
    with acting(rings, ["mark", "stop"]) as (url, supervisor):
        tab.screen(width, height, scheme)
        tab.open(url)
        tab.wait("document.getElementById('link').textContent === 'live' && !document.getElementById('acts').hidden")
        click = "document.getElementById({!r}).click()".format
        tab.run(click("act-stop"))  # without a name
        assert not tab.run("document.getElementById('act-sure').open")
        tab.run("document.getElementById('act-who').value = 'Ada <b>'")
        tab.run("document.getElementById('act-number').value = 12")
        tab.run(click("act-mark-do"))
        assert tab.text("#act-what") == "Mark 12? Set a line in the log, with the name Ada <b>."
        tab.shot(tmp_path / f"sure_{width}_{scheme}.png")
        assert tab.run("document.activeElement.textContent") == "cancel"
        tab.run("document.activeElement.click()")
        assert not tab.run("document.getElementById('act-sure').open")
        tab.run(click("act-mark-do"))
        tab.run(click("act-yes"))
        tab.wait("document.getElementById('act-said').textContent === 'mark 12 is in the log'")
        assert supervisor.said == ["mark 12, asked by the page, Ada <b>"]
        tab.shot(tmp_path / f"acts_{width}_{scheme}.png")
        wide = tab.run("[document.documentElement.scrollWidth, innerWidth]")
        assert wide[0] <= wide[1]
        tab.run(click("act-stop"))
        assert supervisor.ends == ""
        tab.run(click("act-yes"))
        tab.wait("document.getElementById('act-said').textContent === 'the flight is being ended'")
        assert supervisor.ends == "stop, asked by the page, Ada <b>"


def test_a_mark_that_is_cancelled_and_asked_again_at_once_is_set_once(tab: Tab, rings: Rings) -> None:
    """A dialog says that it was closed later: a busy browser says it of both when the second is confirmed."""
    with acting(rings, ["mark", "stop"]) as (url, supervisor):
        tab.open(url)
        tab.wait("document.getElementById('link').textContent === 'live'")
        tab.run("document.getElementById('act-who').value = 'Ada'")
        for sent in range(1, 4):
            tab.run("""(() => {
                const at = id => document.getElementById(id);
                at("act-said").textContent = "";
                at("act-mark-do").click();
                document.activeElement.click();
                at("act-mark-do").click();
                at("act-yes").click();
            })()""")
            tab.wait("document.getElementById('act-said').textContent.endsWith('is in the log')")
            assert len(supervisor.said) == sent


def test_a_page_that_can_do_nothing_shows_no_act(tab: Tab, rings: Rings) -> None:
    with acting(rings, []) as (url, _):
        tab.open(url)
        tab.wait("document.getElementById('link').textContent === 'live'")
        assert tab.run("document.getElementById('acts').hidden")
