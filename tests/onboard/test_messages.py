"""The lines of a flight on stderr: for people, for the journal, as JSON; and that nothing waits for who reads them."""

import io
import json
import logging
import os
import threading
import time

import pytest

from onboard.cli.messages import Handler, JsonLines, MessageLines, spoken

LOGGER = logging.getLogger("heft")


@pytest.fixture(autouse=True)
def _no_journal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    monkeypatch.delenv("INVOCATION_ID", raising=False)


def speak() -> None:
    LOGGER.info("going", extra={"source": "flight", "code": "status"})
    LOGGER.warning("late\n<0>forged \x1b[31mred", extra={"source": "joint_1", "code": "gap"})
    LOGGER.error("gone", extra={"source": "can_0", "code": "bus_failed"})


def test_lines_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    with spoken(quiet=False, json_lines=False) as status_s:
        assert status_s == 1.0
        speak()
    lines = [line.split(" ", 1)[1] for line in capsys.readouterr().err.splitlines()]
    assert lines == ["flight: going", "warning joint_1: late?<0>forged ?[31mred", "error can_0: gone"]


def test_priorities_for_the_journal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INVOCATION_ID", "x")
    with spoken(quiet=False, json_lines=False) as status_s:
        assert status_s == 60.0
        speak()
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["<6>flight: going", "<4>joint_1: late?<0>forged ?[31mred", "<3>can_0: gone"]


def test_quiet_and_json(capsys: pytest.CaptureFixture[str]) -> None:
    with spoken(quiet=True, json_lines=True) as status_s:
        assert status_s is None
        speak()
    said = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [(one["level"], one["source"], one["code"]) for one in said] == [
        ("warning", "joint_1", "gap"),
        ("error", "can_0", "bus_failed"),
    ]
    speak()  # and afterwards it is still
    assert capsys.readouterr().err == ""


def test_a_reader_that_stands_still_holds_nobody_up() -> None:
    reading, writing = os.pipe()
    handler = Handler(os.fdopen(writing, "w"))
    handler.setFormatter(MessageLines(journal=False))
    record = logging.LogRecord("heft", logging.INFO, "", 0, "x" * 500, None, None)
    for _ in range(500):  # a pipe holds 64 KiB: from here on the thread waits in its write
        handler.emit(record)
    time.sleep(0.5)
    began = time.monotonic()
    for _ in range(5000):
        handler.emit(record)
    assert time.monotonic() - began < 5.0
    with os.fdopen(reading) as file:
        lines = [next(line for line in file if "x" * 500 not in line), *(file.readline() for _ in range(50))]
    assert int(lines[0].split()[0]) > 3000
    assert "lines before this were lost: the output was blocked" in lines[0]
    assert all("x" * 500 in line for line in lines[1:])


def test_a_reader_that_is_gone_ends_nothing() -> None:
    stream, threads = io.StringIO(), threading.active_count()
    handler = Handler(stream)
    handler.setFormatter(JsonLines())
    stream.close()
    handler.emit(logging.LogRecord("heft", logging.INFO, "", 0, "x", None, None))
    handler.close()
    assert threading.active_count() == threads
