"""Writes the identified payload into a URDF while all ten of its numbers are good, and removes it when they are not.

Beside the payload's inertial the file has an element ``<identified>`` in ``<robot>``, which URDF readers pass over:
level, time of the answer and the interval of each quantity. It is replaced as a whole every second, so that its
``host_ns`` (CLOCK_MONOTONIC) tells a reader that the flight goes on: a file that is 3 s old, or gone, is no answer.
"""

import contextlib
import os
import re
from collections.abc import Collection
from pathlib import Path

import numpy as np

from drivers.records import Batch, Rows, Severity, event
from onboard import config
from onboard.channels import NUMBERS
from onboard.dynamics.model.inertia import RigidBody, pseudo_inertia, symmetric
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.urdf import with_bodies
from onboard.flight.estimate.answers import PAYLOAD_CHANGES
from onboard.identification.quantities import BODY
from onboard.identification.standing import LEVELS, Level

EVERY_NS = 1_000_000_000  # between two files; for which an answer has been good before it is handed over
_MARK = "<identified "


class HandOver:
    """Of one flight. What an earlier flight, or process, left at the path is removed.

    Args:
        vehicle: with ``hand_over``, which :func:`check` has found good.
    """

    def __init__(self, vehicle: config.Vehicle) -> None:
        assert vehicle.hand_over is not None
        assert vehicle.file.vehicle.payload_link is not None
        self._path, self._urdf, self._link = vehicle.hand_over, vehicle.urdf_text, vehicle.file.vehicle.payload_link
        self._names = [f"{kind}_{self._link}".encode() for kind in BODY]
        with contextlib.suppress(OSError):  # a file of an earlier flight; its time shows that
            self._path.unlink()
        self._places: list[int] = []
        self._there = self._failed = False
        self._answered_ns = self._good_since_ns = self._written_ns = -1

    def step(self, now_ns: int, made: list[Batch]) -> list[Batch]:
        """Write or remove the file after a step of the estimator; events of what changed.

        Args:
            now_ns: time of the step.
            made: by the estimator.
        """
        codes = [batch.rows["code"][0].decode() for batch in made if batch.channel == "event"]
        if changed := [code for code in codes if code in PAYLOAD_CHANGES]:
            return self._withdraw(now_ns, f"the payload is doubted ({changed[0]})")
        answers = next((batch.rows for batch in made if batch.channel == "quantity"), None)
        if answers is None:
            late = now_ns - self._answered_ns > EVERY_NS
            return self._withdraw(now_ns, "no answer for a second") if late else []
        self._answered_ns = now_ns
        if not self._places:
            known = answers["name"].tolist()
            self._places = [known.index(name) for name in self._names]
        ten = answers[self._places]
        if why := _not_good(ten):
            return self._withdraw(now_ns, why)
        self._good_since_ns = now_ns if self._good_since_ns < 0 else self._good_since_ns
        if now_ns - self._good_since_ns < EVERY_NS or now_ns - self._written_ns < EVERY_NS:
            return []
        return self._write(now_ns, ten)

    def _write(self, now_ns: int, ten: Rows) -> list[Batch]:
        value = ten["value"]
        body = RigidBody(float(value[0]), value[1:4].copy(), symmetric(value[4:]))
        if np.linalg.eigvalsh(pseudo_inertia(standard_of(body)))[0] <= 0.0:
            return self._withdraw(now_ns, "no rigid body has these ten numbers together")
        self._written_ns = now_ns
        try:
            _replace(self._path, _with_answers(with_bodies(self._urdf, {self._link: body}), self._link, now_ns, ten))
        except OSError as error:
            said = [] if self._failed else [_said(now_ns, Severity.WARNING, "hand_over_failed", str(error))]
            self._failed = True
            return said
        there, self._there, self._failed = self._there, True, False
        mass = f"{ten['value'][0]:.4g} kg, {ten['low'][0]:.4g} to {ten['high'][0]:.4g}"
        return [] if there else [_said(now_ns, Severity.INFO, "handed_over", f"{mass}: {self._path}")]

    def _withdraw(self, now_ns: int, why: str) -> list[Batch]:
        self._good_since_ns = self._written_ns = -1
        if not self._there:
            return []
        try:
            self._path.unlink(missing_ok=True)
        except OSError as error:
            why = f"{why}; it cannot be removed: {error}"
        self._there = False
        return [_said(now_ns, Severity.WARNING, "hand_over_withdrawn", f"{self._path.name}: {why}")]


def check(vehicle: config.Vehicle, names: Collection[str]) -> None:
    """Refuse a vehicle without all ten numbers, and a path where a file would be lost that no flight handed over.

    Args:
        vehicle: with ``hand_over``, or without.
        names: of the quantities that its estimator answers.

    Raises:
        ConfigError: with the reason.
    """
    path = vehicle.hand_over
    if path is None:
        return
    label = f"--hand-over {path}"
    ten = [f"{kind}_{vehicle.file.vehicle.payload_link}" for kind in BODY]
    if missing := [name for name in ten if name not in names]:
        text = f"a URDF needs all ten numbers of the payload; {vehicle.label} does not estimate {', '.join(missing)}"
        raise config.ConfigError(f"{label}: {text}")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        text = f"{path.parent} is no directory that can be written; make it, or name another"
        raise config.ConfigError(f"{label}: {text}")
    if not path.exists():
        return
    try:
        is_ours = path.is_file() and _MARK in path.read_text(encoding="utf-8") and not path.samefile(vehicle.urdf_path)
    except (OSError, UnicodeDecodeError):
        is_ours = False
    if not is_ours:
        raise config.ConfigError(f"{label}: a file is there that no flight has handed over; move it, or name another")


def _replace(path: Path, text: str) -> None:
    """Write a file whole or not at all: whoever reads it has the one before or this one.

    Raises:
        OSError: it cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.new")
    unfinished.unlink(missing_ok=True)  # whatever it is: neither waited for nor followed
    with unfinished.open("x", encoding="utf-8") as file:
        file.write(text)
    unfinished.replace(path)


def _not_good(ten: Rows) -> str:
    """The first quantity that is not good, and why; empty where all are."""
    bad = np.flatnonzero((ten["supported"] == 0) | (ten["level"] != LEVELS.index(Level.GOOD)))
    if not bad.size:
        return ""
    one = ten[bad[0]]
    return f"{one['name'].decode()} is {LEVELS[int(one['level'])]}: {one['why'].decode('utf-8', 'replace')}"


def _with_answers(urdf: str, link: str, now_ns: int, ten: Rows) -> str:
    """The URDF with the element ``<identified>`` at its end."""
    from xml.sax.saxutils import quoteattr  # noqa: PLC0415 - brings an HTTP client to every start

    lines = [f'  {_MARK}link={quoteattr(link)} level="good" host_ns="{now_ns}" vehicle_ns="{ten["vehicle_ns"][0]}">']
    for one in ten:
        numbers = " ".join(f'{field}="{float(one[field])!r}"' for field in NUMBERS)
        name, unit = quoteattr(one["name"].decode()), quoteattr(one["unit"].decode())
        lines.append(f"    <quantity name={name} unit={unit} {numbers}/>")
    end = [found.start() for found in re.finditer(r"</robot\s*>", urdf)][-1]
    return "\n".join([urdf[:end].rstrip(), *lines, "  </identified>", urdf[end:]])


def _said(now_ns: int, severity: Severity, code: str, text: str) -> Batch:
    return event(now_ns, severity, code, "estimation", text)
