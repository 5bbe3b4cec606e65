"""A coverage-guided engine of our own: by seed and number of executions it does the same every time."""

import random
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from types import CodeType, FrameType
from typing import Any

from bench.fuzzing import Target
from bench.fuzzing.findings import OURS, FuzzFindings, Result

INTERESTING = (b"\0", b"\xff", b"\x7f", b"\x80", b"\r", b"\n", b"!", b" ", b"+", b"0", b"\xff\xff\xff\xff", bytes(4))

Edge = tuple[CodeType, int, int]


class Coverage:
    """Steps from line to line in what is ours, as the interpreter's trace function sees them."""

    def __init__(self) -> None:
        self.seen: set[Edge] = set()
        self._now: set[Edge] = set()

    def of(self, run: Callable[[bytes], None], data: bytes) -> bool:
        """Run; whether it went where no run went before."""
        self._now = set()
        before = sys.gettrace()
        sys.settrace(self._trace)
        try:
            run(data)
        finally:
            sys.settrace(before)
        fresh = not self._now <= self.seen
        self.seen |= self._now
        return fresh

    def _trace(self, frame: FrameType, event: str, argument: object) -> Callable[..., Any] | None:
        code = frame.f_code
        if not code.co_filename.startswith(OURS):
            return None
        add = self._now.add
        last = 0

        def line(frame: FrameType, event: str, argument: object) -> Callable[..., Any]:
            nonlocal last
            now = frame.f_lineno
            add((code, last, now))
            last = now
            return line

        return line


def mutated(rng: random.Random, corpus: Sequence[bytes], most_bytes: int) -> bytes:
    """One of the corpus after one to six changes: bits, bytes, stretches out, again, in another place, of another."""
    data = bytearray(rng.choice(corpus))
    for _ in range(rng.choice((1, 1, 2, 3, 6))):
        at = rng.randrange(len(data) + 1)
        end = min(len(data), at + rng.choice((1, 2, 4, 16, 64)))
        match rng.randrange(9):
            case 0 if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)
            case 1 if data:
                data[at % len(data)] = rng.randrange(256)
            case 2:
                some = rng.choice(INTERESTING)
                data[at : at + len(some)] = some
            case 3:
                del data[at:end]
            case 4:
                data[at:at] = data[at:end] * rng.choice((1, 1, 2, 8))
            case 5:
                del data[at:]
            case 6:
                other = rng.choice(corpus)
                data[at:] = other[rng.randrange(len(other) + 1) :]
            case 7:
                other = rng.choice(corpus)
                first = rng.randrange(len(other) + 1)
                data[at:at] = other[first : first + rng.choice((1, 8, 32))]
            case _ if data:
                data[at % len(data)] = (data[at % len(data)] + rng.choice((-1, 1))) % 256
    return bytes(data[:most_bytes])


def fuzz(target: Target, seed: int, findings: FuzzFindings, executions: int | None, seconds: float) -> Result:
    """Run for so many executions, or for so long when that is None."""
    rng = random.Random(seed)
    seeds = target.seeds
    coverage, corpus = Coverage(), list(seeds)
    began = time.monotonic()
    done = paths = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        while done < executions if executions is not None else time.monotonic() - began < seconds:
            data = seeds[done] if done < len(seeds) else mutated(rng, corpus, target.most_bytes)
            if coverage.of(findings.run, data):
                paths += 1
                corpus.append(data)
            done += 1
    return Result(done, time.monotonic() - began, paths, list(findings.files.values()))
