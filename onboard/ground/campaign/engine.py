"""Runs a campaign's items on Dask workers: processes of this computer, or those of a scheduler that is named.

There is one engine, dask.distributed: locally it has a ``LocalCluster`` of processes, so that a worker that dies or
grows beyond its memory is replaced and its flight flown again, which ``concurrent.futures`` does not do (one death
breaks its pool). Results come back to this process, which alone writes: workers share no disk with it. A scheduler that
is gone is waited for, and what it had is submitted again.
"""

import contextlib
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from typing import Any, NamedTuple

from distributed import Client, KilledWorker, LocalCluster, as_completed
from distributed.comm.core import CommClosedError

from onboard.ground.campaign.design import Item
from onboard.ground.campaign.results import Returned
from onboard.ground.campaign.store import Store

Fly = Callable[[Item, str], Returned]
_LOST = (OSError, TimeoutError, CommClosedError)
_REMEDY = "install the same version of heft, and of what a plan calls, on all workers"
_KILLED = "it ended every worker that flew it: more memory than a worker may have (--memory), or a crash"
_AGAIN_S = 1.0  # between two tries to reach a scheduler
_ANSWERS_S = 10  # a scheduler that is there


class SchedulerError(ValueError):
    """There is no scheduler."""


class WorkerError(ValueError):
    """A worker cannot do what it is asked for."""


class _AwayError(Exception):
    """The connection to the scheduler broke, or was never made."""


class Where(NamedTuple):
    """Where flights are flown.

    Attributes:
        scheduler: address of Dask's, ``tcp://host:8786``; a cluster of processes here without one.
        jobs: processes here.
        memory: of each of these, in words of Dask: ``2GB``, or ``auto`` for an equal share; a process that has more is
            ended, and its flight flown again.
        dashboard: where Dask's page is served, ``host:port``.
        patience_s: how long a scheduler that is gone is waited for.
    """

    scheduler: str | None = None
    jobs: int = 1
    memory: str = "auto"
    dashboard: str = "127.0.0.1:0"
    patience_s: float = 300.0


class CampaignWatcher(NamedTuple):
    """What is called while a campaign runs."""

    dashboard: Callable[[str], None] = lambda link: None
    done: Callable[[Item, Returned], None] = lambda item, done: None


NOBODY = CampaignWatcher()


def run(
    items: Mapping[str, Item], revision: str, fly: Fly, where: Where, store: Store, watcher: CampaignWatcher = NOBODY
) -> None:
    """Do every item, in any order, and keep what comes of it.

    Args:
        items: by address; those that have no result.
        revision: of the code.
        fly: what a worker does; a function at the top of a module.
        where: it is done.
        store: that keeps it.
        watcher: called on the way.

    Raises:
        SchedulerError: none answers at the address, or it stays away.
        WorkerError: a worker's code is another, or it has none.
    """
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what it warns of is dealt with here
    left, tries, reached = dict(items), 0, False
    while left:
        try:
            for address, done in _collected(where, left, revision, fly, watcher.dashboard):
                reached = True
                if done is not None:
                    tries = 0
                    item = left.pop(address)
                    store.take(address, item, revision, done)
                    watcher.done(item, done)
        except _AwayError as error:
            if not reached or tries * _AGAIN_S >= where.patience_s:
                said = "start it with dask scheduler, and workers with dask worker; then the same command goes on"
                raise SchedulerError(
                    f"no Dask scheduler at {where.scheduler or 'this computer'} ({error}): {said}"
                ) from error
        if left:
            tries += 1
            time.sleep(_AGAIN_S)


@contextlib.contextmanager
def _client(where: Where) -> Iterator[Any]:
    if where.scheduler is not None:
        with Client(where.scheduler, timeout=_ANSWERS_S, set_as_default=False) as client:
            yield client
        return
    with (
        LocalCluster(
            n_workers=where.jobs,
            threads_per_worker=1,
            processes=True,
            memory_limit=where.memory,
            dashboard_address=where.dashboard,
            silence_logs=50,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _collected(
    where: Where, items: Mapping[str, Item], revision: str, fly: Fly, tell: Callable[[str], None]
) -> Iterator[tuple[str, Returned | None]]:
    """Results as they come; first of all ("", None) when the scheduler is reached.

    It ends when there are no more, also because the scheduler has gone and come back without them.
    """
    try:
        with _client(where) as client:
            tell(str(client.dashboard_link))
            yield "", None
            keys = [f"flight-{address}" for address in items]
            waiting = as_completed(
                [client.submit(fly, item, revision, key=key) for key, item in zip(keys, items.values(), strict=True)],
                loop=client.loop,
            )  # keeps none of those that it has given: a result leaves the workers when it is taken
            for future in waiting:
                if future.status in ("cancelled", "lost"):
                    continue
                try:
                    done = future.result()
                except KilledWorker:
                    done = Returned(None, _KILLED)
                except CancelledError:
                    continue
                except _LOST:  # a flight's errors come back in its result
                    raise
                except Exception as error:
                    raise WorkerError(f"a worker cannot fly: {type(error).__name__}: {error}; {_REMEDY}") from error
                yield future.key.removeprefix("flight-"), done
    except WorkerError:
        raise
    except Exception as error:  # Dask says in many ways that a connection is lost
        if where.scheduler is None and not isinstance(error, _LOST):
            raise
        raise _AwayError(f"{type(error).__name__}: {error}") from error
