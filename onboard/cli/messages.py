"""Messages of a flight on stderr: text lines, with priorities under systemd, or JSON.

A stopped terminal or a hanging journal must not delay a flight: lines are queued for a separate thread; those lost to a
full queue are counted and the count is printed.
"""

import contextlib
import json
import logging
import os
import queue
import sys
import threading
import time
from collections.abc import Iterator
from typing import TextIO

_WAITING = 1000  # lines
_LAST_WORDS_S = 2.0
_PRIORITIES = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))  # of syslog, as systemd reads them
STATUS_S, STATUS_IN_JOURNAL_S = 1.0, 60.0


def in_journal() -> bool:
    """Whether a service manager started this, and the journal reads its stderr."""
    return "JOURNAL_STREAM" in os.environ or "INVOCATION_ID" in os.environ


class MessageLines(logging.Formatter):
    """``12:34:56 warning joint_1: no_answer: text``; under systemd ``<4>joint_1: no_answer: text``."""

    def __init__(self, *, journal: bool) -> None:
        super().__init__()
        self._journal = journal

    def format(self, record: logging.LogRecord) -> str:
        """See ``logging.Formatter``."""
        text = "".join(c if c.isprintable() else "?" for c in record.getMessage())
        line = f"{getattr(record, 'source', record.name)}: {text}"
        if self._journal:
            return f"<{next((p for level, p in _PRIORITIES if record.levelno >= level), 7)}>{line}"
        level = f"{record.levelname.lower()} " if record.levelno > logging.INFO else ""
        return f"{time.strftime('%H:%M:%S', time.localtime(record.created))} {level}{line}"


class JsonLines(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        """See ``logging.Formatter``."""
        said = {"time_s": record.created, "level": record.levelname.lower()}
        told = {key: getattr(record, key) for key in ("source", "code") if hasattr(record, key)}
        return json.dumps({**said, **told, "text": record.getMessage()})


class Handler(logging.Handler):
    """Writes lines to ``stream`` in a thread of its own, and never waits for it."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream, self._unsaid = stream, 0
        self._lines: queue.Queue[str | None] = queue.Queue(_WAITING)
        self._thread = threading.Thread(target=self._write, name="messages", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:
        """See ``logging.Handler``."""
        try:
            self._lines.put_nowait(self.format(record))
        except queue.Full:
            self._unsaid += 1

    def close(self) -> None:
        """Write what waits, but do not wait long for that."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(None)
        self._thread.join(_LAST_WORDS_S)
        super().close()

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            if self._unsaid:
                line, self._unsaid = (f"{line}\n{self._unsaid} lines before this were lost: the output was blocked", 0)
            with contextlib.suppress(OSError, ValueError):  # the reader has gone: the flight continues
                self._stream.write(f"{line}\n")
                self._stream.flush()


@contextlib.contextmanager
def spoken(*, quiet: bool, json_lines: bool) -> Iterator[float | None]:
    """A flight's messages go to stderr meanwhile; gives the seconds between two status lines, None for none.

    Args:
        quiet: warnings and errors only.
        json_lines: as JSON.
    """
    journal = in_journal() and not json_lines
    logger = logging.getLogger("heft")
    handler = Handler(sys.stderr)
    handler.setFormatter(JsonLines() if json_lines else MessageLines(journal=journal))
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING if quiet else logging.INFO)
    try:
        yield None if quiet else STATUS_IN_JOURNAL_S if in_journal() else STATUS_S
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        handler.close()
