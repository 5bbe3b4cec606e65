"""Orders of an operator: carried out where the vehicle file arms them, whoever hands them in."""

from pathlib import Path

import pytest

from drivers.records import Severity
from onboard import config
from onboard.channels import Order, Refusal
from onboard.config.telemetry import Telemetry
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.store import rings
from onboard.flight.store.orders import PAGE, UPLINK, OrderBook, order_channels, order_row
from onboard.flight.supervise.orders import Orders
from onboard.recording.format.texts import printable
from onboard.ring import RingReader

NOW_NS = 5_000_000_000


class Bench:
    """A supervisor's side, and both processes that take orders."""

    def __init__(self, directory: Path, commands: list[str]) -> None:
        vehicle = config.named("rocksat")
        armed = Telemetry(commands=commands)  # type: ignore[arg-type]
        self.vehicle = vehicle.model_copy(update={"file": vehicle.file.model_copy(update={"telemetry": armed})})
        self.said: list[tuple[Severity, str, str, str]] = []
        writers = rings.create(directory, self.vehicle, order_channels(self.vehicle))
        publish = Publisher(writers, "_supervisor").publish
        self.orders = Orders(self.vehicle, directory, lambda *one: self.said.append(one), publish)
        self.books = [OrderBook(directory, name) for name in (UPLINK, PAGE)] if commands else []


def test_orders_are_carried_out_and_replied_to_who_gave_them(tmp_path: Path) -> None:
    bench = Bench(tmp_path, ["mark", "stop"])
    uplink, page = bench.books
    assert uplink.give(order_row(NOW_NS, Order.MARK, "a", number=3)) == 0
    assert page.give(order_row(NOW_NS, Order.MARK, "b", number=4)) == 0
    assert page.give(order_row(NOW_NS, Order.SPAN, "b", begin_ns=0, end_ns=9_000_000_000)) == 1
    assert bench.orders.step(NOW_NS) == ""
    assert uplink.replies() == {0: Refusal.NONE}
    assert page.replies() == {0: Refusal.NONE, 1: Refusal.NOT_ARMED}
    assert page.give(order_row(NOW_NS, Order.STOP, "b")) == 2
    assert bench.orders.step(NOW_NS) == "stop, asked by b"
    assert (uplink.replies(), page.replies()) == ({}, {2: Refusal.NONE})
    assert bench.said == [
        (Severity.INFO, "mark", "operator", "mark 3, asked by a"),
        (Severity.INFO, "mark", "operator", "mark 4, asked by b"),
        (Severity.WARNING, "order_refused", "operator", "span of 9 s of the log, asked by b: refused, not armed"),
        (Severity.INFO, "stop", "operator", "stop, asked by b"),
    ]


@pytest.mark.parametrize(
    ("row", "refused"),
    [
        (order_row(NOW_NS, Order.STOP, "a"), Refusal.NOT_ARMED),
        (order_row(NOW_NS, 0, "a"), Refusal.UNKNOWN),
        (order_row(NOW_NS, 99, "a"), Refusal.UNKNOWN),
        (order_row(NOW_NS, Order.MARK, "a", Refusal.DUPLICATE), Refusal.DUPLICATE),
    ],
)
def test_what_is_not_armed_or_was_refused_is_not_done(tmp_path: Path, row: object, refused: Refusal) -> None:
    bench = Bench(tmp_path, ["mark"])
    bench.books[0].give(row)  # type: ignore[arg-type]
    assert bench.orders.step(NOW_NS) == ""
    assert bench.books[0].replies() == {0: refused}
    [(severity, code, _, text)] = bench.said
    assert (severity, code) == (Severity.WARNING, "order_refused")
    assert text.endswith(f"asked by a: refused, {refused.name.lower().replace('_', ' ')}")


def test_without_an_armed_command_there_is_no_way_to_give_one(tmp_path: Path) -> None:
    bench = Bench(tmp_path, [])
    assert bench.orders.step(NOW_NS) == ""
    assert list(tmp_path.glob("*.ring")) == []
    with pytest.raises(OSError, match="order_page"):
        OrderBook(tmp_path, PAGE)


def test_the_rows_say_who_and_when(tmp_path: Path) -> None:
    bench = Bench(tmp_path, ["mark"])
    bench.books[1].give(order_row(NOW_NS, Order.MARK, "the page, Ada", number=3))
    [row] = RingReader(tmp_path / f"{PAGE}.ring").read()[0]
    assert (int(row["host_ns"]), int(row["number"]), printable(row["who"])) == (NOW_NS, 3, "the page, Ada")
