"""The page's process, and its start and end by the command line.

It starts before the flight, so that an unusable address is refused before take-off, and ends with the flight.
"""

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from onboard.page import address as addresses
from onboard.page.follow import Followed, packed
from onboard.page.web import Source, Web

FRAME_S = 0.25
_CHECK_EVERY = 4  # frames
_NICENESS = 10
_READY = "ready"


@contextlib.contextmanager
def serving(log: Path, address: str) -> Iterator[str]:
    """Run a page process for the flight recorded to ``log`` while the context lasts.

    Yields:
        The page's address, with the token where it needs one.

    Raises:
        ValueError: the address is invalid or not available; the message gives the reason.
    """
    addresses.parse(address)
    command = [sys.executable, "-m", "onboard.page", str(log), address]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            ready, _, said = process.stdout.readline().strip().partition(" ")
            if ready != _READY:
                raise ValueError(f"--page: {f'{ready} {said}'.strip() or 'the page process did not start'}")
            yield said
        finally:
            process.terminate()


def main(arguments: Sequence[str]) -> int:
    """Body of the process; ``arguments`` are the log's path and the checked address."""
    log, address = Path(arguments[0]).absolute(), addresses.parse(arguments[1])
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # the flight goes on without its terminal, and viewers with it
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's ^C ends the flight, which ends this process
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)  # lower priority than the flight

    def ready(url: str) -> None:
        sys.stdout.write(f"{_READY} {url}\n")
        sys.stdout.flush()

    followed = Followed(log)
    try:
        asyncio.run(serve(followed, address, ready))
    except OSError as error:
        sys.stdout.write(f"{arguments[1] or addresses.DEFAULT_HOST}: {error.strerror or error}; give another address\n")
        return 2
    finally:
        followed.close()
    return 0


async def serve(source: Source, address: addresses.Address, ready: Callable[[str], None]) -> None:
    """Serve ``source`` until SIGTERM, or until the flight that it follows has ended.

    Args:
        source: a :class:`Followed` flight, or a log.
        address: to bind to.
        ready: is told the page's address.

    Raises:
        OSError: the address is not available.
    """
    over = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, *(() if source.live else (signal.SIGINT,))):
        loop.add_signal_handler(number, over.set)
    token = addresses.token_for(address)
    web = Web(source, address, token)
    await web.start()
    ready(addresses.url(address, web.port, token))
    try:
        if isinstance(source, Followed):
            await _follow(source, web, over)
        else:
            await over.wait()
    finally:
        await web.close()


async def _follow(followed: Followed, web: Web, over: asyncio.Event) -> None:
    """Frames at a steady rate while there are viewers, and a last one."""
    loop = asyncio.get_running_loop()
    looks = 0
    while not over.is_set() and not followed.ended:
        followed.look()
        if looks % _CHECK_EVERY == 0:
            followed.check_ended()
        looks += 1
        if web.viewers:
            web.send(packed(followed.state.frame(int(loop.time() * 1e9))))
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(over.wait(), FRAME_S)
    followed.look()
    followed.ended = True
    web.send(packed(followed.state.frame(ended=True)))
