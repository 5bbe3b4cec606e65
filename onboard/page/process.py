"""The page's process, and its start by the command line.

The plan's expected intervals, which the page shows beside those of the answers.
"""

import asyncio
import contextlib
import json
import math
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from onboard.flight.supervise.companion import beside, ready, settle
from onboard.page import address as addresses
from onboard.page.acts import ACTS, Acts
from onboard.page.follow import Followed, packed
from onboard.page.web import Source, Web

if TYPE_CHECKING:  # the downlink takes memory
    from onboard.page.received import Received

_HALF = NormalDist().inv_cdf(0.975)
FRAME_S = 0.25
_CHECK_EVERY = 4  # frames


def read(path: Path | None) -> dict[str, dict[str, Any]]:
    """``half`` (of the 95 % interval at the plan's end) and ``unit`` of each quantity of a ``plan.json``.

    Those that the plan cannot tell are left out; without a path there are none.

    Raises:
        ValueError: not a plan of a motion; the message gives the remedy.
    """
    if path is None:
        return {}
    try:
        expected = json.loads(path.read_bytes())["expected"]
        found = {str(one["name"]): (_HALF * float(one["sigma"]), str(one["unit"])) for one in expected}
    except OSError as error:
        raise ValueError(f"--page-plan {path}: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"--page-plan {path}: give the plan.json that heft plan wrote for a single motion") from error
    return {name: {"half": half, "unit": unit} for name, (half, unit) in found.items() if 0.0 < half < math.inf}


class _Given(NamedTuple):
    """What the process is started with besides."""

    acts: list[str]
    plan: str | None
    urdf: str | None


@contextlib.contextmanager
def serving(
    log: Path, address: str, plan: Path | None = None, acts: Sequence[str] = (), urdf: Path | None = None
) -> Iterator[str]:
    """Run a page process for the flight recorded to ``log`` while the context lasts.

    Args:
        log: of the flight.
        address: to bind to.
        plan: whose expected intervals are shown.
        acts: orders that its vehicle file arms; they can be given on the loopback interface alone.
        urdf: of the vehicle, beside which its meshes lie.

    Yields:
        The page's address, with the token where it needs one.

    Raises:
        ValueError: the address is invalid or not available, or the file no plan; the message gives the reason.
    """
    addresses.parse(address)
    read(plan)
    given = _Given(list(acts), *(None if one is None else str(one.absolute()) for one in (plan, urdf)))
    with beside("onboard.page", [str(log), address, json.dumps(given)], "--page") as url:
        yield url


def main(arguments: Sequence[str]) -> int:
    """Body of the process; ``arguments``: the log's path, the checked address, and :class:`_Given` as JSON, or not."""
    log, address = Path(arguments[0]).absolute(), addresses.parse(arguments[1])
    followed = Followed(log, settle())
    given = _Given(*json.loads(arguments[2])) if len(arguments) > 2 else _Given([], None, None)
    armed = [one for one in given.acts if one in ACTS]
    acts = Acts(followed, armed) if armed and address.is_local else None
    plan, urdf = (None if one is None else Path(one) for one in (given.plan, given.urdf))
    try:
        asyncio.run(serve(followed, address, ready, plan, acts, urdf))
    except OSError as error:
        sys.stdout.write(f"{arguments[1] or addresses.DEFAULT_HOST}: {error.strerror or error}; give another address\n")
        return 2
    finally:
        followed.close()
    return 0


async def serve(
    source: Source,
    address: addresses.PageAddress,
    tell: Callable[[str], None],
    plan: Path | None = None,
    acts: Acts | None = None,
    urdf: Path | None = None,
) -> None:
    """Serve ``source`` until SIGTERM, or until the flight that it follows has ended.

    Args:
        source: a flight that goes on, or a log.
        address: to bind to.
        tell: is called with the page's address.
        plan: whose expected intervals are shown.
        acts: what can be done through the page.
        urdf: beside which meshes lie.

    Raises:
        OSError: the address is not available.
        ValueError: the file is no plan.
    """
    planned = read(plan)
    over = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, *(() if source.live else (signal.SIGINT,))):
        loop.add_signal_handler(number, over.set)
    token = addresses.token_for(address, acts=acts is not None)
    web = Web(source, address, token, planned, acts, urdf)
    await web.start()
    tell(addresses.url(address, web.port, token))
    try:
        if source.live:
            await _follow(cast("Followed | Received", source), web, over)
        else:
            await over.wait()
    finally:
        await web.close()


async def _follow(followed: "Followed | Received", web: Web, over: asyncio.Event) -> None:
    """Frames at a steady rate while there are viewers, and a last one."""
    loop = asyncio.get_running_loop()
    looks = 0
    while not over.is_set() and not followed.ended:
        followed.look()
        if looks % _CHECK_EVERY == 0:
            followed.check_ended()
        looks += 1
        if web.viewers:
            web.send(packed(followed.frame_now(int(loop.time() * 1e9))))
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(over.wait(), FRAME_S)
    followed.look()
    followed.ended = True
    web.send(packed(followed.frame_now(0, ended=True)))
