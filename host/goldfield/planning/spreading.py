"""Work spread over processes of this machine or over Dask workers of any, such as a plan: the map is the same.

A tile's result depends on the request and the tile alone, so it does not matter who computes it, nor in which order.
`spread` is for whatever else is so.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from importlib import import_module
from importlib.metadata import version
from itertools import islice
from typing import Any, TypeVar

import numpy as np

from goldfield.errors import SystemFailure, UserError, option
from goldfield.planning.codes import keep_worst, listed, shared_codes
from goldfield.planning.freed_memory import keep_freed_memory
from goldfield.planning.grid import Tile
from goldfield.planning.maps import Figures, Maps
from goldfield.planning.request import Request
from goldfield.planning.tile import TileResult, compute_tile

BATCH = 8
"""Tiles that are sent at once: tenths of a second of work, so that sending costs nothing and progress shows."""

AHEAD = 4
"""Batches a worker that are sent before their turn: enough to keep it busy, few enough to end soon."""

CONNECT_S = 10.0
"""Longest wait for a Dask scheduler, s."""

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")
Compute = Callable[[S, list[T]], list[R]]
"""Computes a batch of items with what all batches share; other processes have it by its name."""


def plan(
    request: Request,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda points: None,
) -> Maps:
    """Compute a plan.

    Parameters
    ----------
    request : Request
    workers : int
        Processes of this machine; 1 computes in this one.
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://10.0.0.1:8786, whose workers compute in place of processes here.
        They need the same version of goldfield.
    progress : callable, optional
        Is called with the number of points that have just been computed.

    Raises
    ------
    UserError
        If the request is none.
    SystemFailure
        If the scheduler does not answer or has no workers, or a worker dies.
    """
    if not isinstance(request, Request):
        raise UserError(f"plan() takes a Request of site, grid and settings, not {request!r:.60}")
    figures = Figures.empty(request.grid.shape, request.settings.best)
    worst: dict[tuple[int, int], float] = {}
    tiles = request.grid.tiles()
    batches = [tiles[first : first + BATCH] for first in range(0, len(tiles), BATCH)]
    with closing(spread(compute_batch, request, batches, workers=workers, scheduler=scheduler)) as results:
        for result in results:
            figures.put(result.tile, result.figures)
            keep_worst(worst, result.conflicts)
            progress(len(result.figures.weak))
    beacons, found = request.site.beacons, listed(worst)
    return Maps(
        grid=request.grid,
        figures=figures,
        conflicts=found,
        shared_code=shared_codes(found, len(beacons)),
        beacon_ids=tuple(beacon.id for beacon in beacons),
        beacon_position_m=np.array([beacon.position_m for beacon in beacons]),
    )


def compute_batch(request: Request, tiles: list[Tile]) -> list[TileResult]:
    """Compute some tiles; this is what workers are sent."""
    return [compute_tile(request, tile) for tile in tiles]


def spread(
    compute: Compute[S, T, R], shared: S, batches: list[list[T]], *, workers: int = 1, scheduler: str | None = None
) -> Generator[R]:
    """Yield the results of all batches, in any order; the parameters and errors are those of `plan`.

    Parameters
    ----------
    compute : Compute
    shared
        What all batches need; it is sent once.
    batches : list of lists
        Each of tenths of a second of work.
    workers, scheduler
    """
    if scheduler is not None:
        return _by_dask(compute, shared, batches, scheduler)
    if workers > 1 and len(batches) > 1:
        return _by_processes(compute, shared, batches, min(workers, len(batches)))
    return _here(compute, shared, batches)


def _here(compute: Compute[S, T, R], shared: S, batches: list[list[T]]) -> Generator[R]:
    keep_freed_memory()
    for batch in batches:
        yield from compute(shared, batch)


_task: list[Any] = []
"""In a process of the pool: what computes and what all batches share, which were sent once."""


def _begin(compute: Any, shared: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process of the terminal: the first one ends us
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    keep_freed_memory()
    _task[:] = [compute, shared]


def _compute(batch: list[Any]) -> list[Any]:
    compute, shared = _task
    return list(compute(shared, batch))


def _by_processes(compute: Compute[S, T, R], shared: S, batches: list[list[T]], workers: int) -> Generator[R]:
    context = multiprocessing.get_context("spawn")  # a fork would inherit locks and threads
    with one_thread_each():
        pool = ProcessPoolExecutor(workers, context, _begin, (compute, shared))
        first = [pool.submit(_compute, batch) for batch in batches[: AHEAD * workers]]
    rest = iter(batches[len(first) :])
    pending: set[Future[list[R]]] = set(first)
    try:
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                yield from future.result()
            pending |= {pool.submit(_compute, batch) for batch in islice(rest, len(done))}
    except BrokenProcessPool as error:
        raise SystemFailure(
            f"a process of {option('workers', workers)} was ended from outside, often for want of memory: give fewer"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let processes that are started meanwhile multiply matrices in one thread, as there is one of them a core."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _on_worker(compute: Compute[S, T, R], shared: S, batch: list[T]) -> list[R]:
    keep_freed_memory()
    return compute(shared, batch)


def _by_dask(compute: Compute[S, T, R], shared: S, batches: list[list[T]], address: str) -> Generator[R]:
    dask: Any = import_module("distributed")  # an optional package, which takes a second to load
    try:
        _check_address(address)
        client = dask.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, TypeError, ValueError) as error:  # TLS without certificates is a TypeError
        raise SystemFailure(
            f"no Dask scheduler answers at {option('scheduler', address)} ({_words(error)}): start one with "
            "'dask scheduler'"
        ) from error
    with client:
        workers = _workers(client, address)
        rest = iter(batches)
        try:
            sent = client.scatter(shared, broadcast=True)
            ahead = islice(rest, AHEAD * workers)
            first = [client.submit(_on_worker, compute, sent, batch, pure=False) for batch in ahead]
            running = dask.as_completed(first, loop=client.loop)
            for future in running:
                results = future.result()
                future.release()
                for following in islice(rest, 1):
                    running.add(client.submit(_on_worker, compute, sent, following, pure=False))
                yield from results
        except Exception as error:
            raise SystemFailure(f"a worker of {option('scheduler', address)} failed: {_words(error)}") from error


def _check_address(address: str) -> None:
    """Raise `ValueError` for what is no address; Dask's client would wait 20 s, and print a traceback as it goes."""
    addressing: Any = import_module("distributed.comm.addressing")
    host, port = addressing.get_address_host_port(address)
    if not host or not 0 < port < 65536:
        raise ValueError(f"no host and port in {address!r}")


def _workers(client: Any, address: str) -> int:
    """Return how many workers a scheduler has; refuse none, and those of another version."""
    workers = len(client.scheduler_info(n_workers=-1)["workers"])
    if not workers:
        raise SystemFailure(
            f"the Dask scheduler at {option('scheduler', address)} has no workers: start some with 'dask worker "
            f"{address}'"
        )
    try:
        versions = set(client.run(version, "goldfield").values())
    except Exception as error:  # whatever a worker of another installation raises
        raise SystemFailure(
            f"a worker of {option('scheduler', address)} has no goldfield ({_words(error)}): install it there"
        ) from error
    if versions != {version("goldfield")}:
        raise SystemFailure(
            f"workers of {option('scheduler', address)} have goldfield {', '.join(sorted(versions))}, here is "
            f"{version('goldfield')}: install the same"
        )
    return workers


def _words(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
