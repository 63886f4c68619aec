"""Computing chunks on a Dask cluster: the same loop as for local processes, with futures that come from afar."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from functools import lru_cache
from typing import Any, TypeVar

from jointplay import solver
from jointplay.catalogue.errors import BuildError, SchedulerAddressError
from jointplay.catalogue.storage.manifest import package_versions

WAIT = 120.0
"""Longest wait for a scheduler that is gone, or for a first worker [s]."""

FIRST_WAIT = 10.0
"""Longest wait for the first answer of a scheduler [s]: one that has never answered was hardly there."""

_ASK = 2.0
"""Time between questions for the number of workers [s]."""

_ON_THE_WAY = (OSError, TimeoutError, CancelledError, asyncio.CancelledError)
"""What a connection raises that is lost, or whose client leaves."""

_ONE_AT_A_TIME = threading.Lock()

A = TypeVar("A")
R = TypeVar("R")


class DaskCluster:
    """Workers of a Dask scheduler.

    Workers that die are replaced by whoever runs the cluster; their tasks go to others. When the scheduler dies, what
    is in flight is begun again as soon as one answers at the same address. Workers must hold the same versions of the
    solver and of the packages that shape its numbers; a task that meets others ends the build.

    Parameters
    ----------
    address : str
        Of the scheduler: ``tcp://host:8786``.
    wait : float, optional
        Longest wait for a scheduler that is gone, or for a first worker [s].
    first_wait : float, optional
        Longest wait for the first answer of the scheduler [s].
    tell : callable, optional
        Called with what is waited for, in words, before it is waited for.

    Raises
    ------
    BuildError
        The package ``distributed`` is missing, no scheduler answers, or it has no worker.
    SchedulerAddressError
        The address is none.
    """

    _client: Any = None  # its methods carry no types

    def __init__(
        self,
        address: str,
        *,
        wait: float = WAIT,
        first_wait: float = FIRST_WAIT,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        check_address(address)
        self._distributed: Any = _import_distributed()
        self._address, self._wait = address, wait
        self._threads, self._asked, self._seen = 0, 0.0, time.monotonic()
        self._tell = tell or (lambda said: None)
        self._tell(f"waiting for the scheduler {address}, up to {first_wait:.0f} s")
        self._connect(first_wait)
        if not self._client.nthreads():
            self._tell(f"waiting for a worker of the scheduler {address}, up to {wait:.0f} s")
        with self._explain(wait):
            self._client.wait_for_workers(1, timeout=wait)

    @property
    def capacity(self) -> int:
        """Two tasks a thread, so that no worker waits for the builder to store a result.

        Raises
        ------
        BuildError
            There has been no scheduler, or no worker, for too long.
        """
        now = time.monotonic()
        if now - self._asked >= _ASK:
            self._asked = now
            self._connect()
            # Where the scheduler is gone in this very moment, the next question finds it or says so.
            with contextlib.suppress(OSError, RuntimeError, asyncio.TimeoutError):
                self._threads = sum(self._client.nthreads().values())
            if self._threads:
                self._seen = time.monotonic()
            elif time.monotonic() - self._seen > self._wait:
                raise BuildError(f"{self._address}: no worker of the cluster for {self._wait:.0f} s")
        return max(2 * self._threads, 1)

    def submit(self, task: Callable[[A], R], argument: A) -> Future[R]:
        """Begin ``task(argument)`` on a worker; both, and the result, must be picklable."""
        self._connect()
        local: Future[R] = Future()
        try:
            remote = self._client.submit(_at_worker, task, argument, _versions(), pure=False, retries=0)
        except Exception as error:
            if self._client.status == "running":
                raise
            local.set_exception(_LostOnTheWayError(str(error)))
            return local
        remote.add_done_callback(lambda done: self._hand_over(done, local))
        return local

    def is_loss(self, error: BaseException) -> bool:
        """Whether the worker died with the task, again and again: the scheduler has tried others."""
        return isinstance(error, self._distributed.KilledWorker) or self.is_blameless(error)

    def is_blameless(self, error: BaseException) -> bool:
        """Whether the scheduler was lost, or a result on its way."""
        return isinstance(error, _LostOnTheWayError)

    def close(self, *, at_once: bool = False) -> None:
        """Leave the cluster; it drops what this builder has in flight."""
        if self._client is None:
            return
        with contextlib.suppress(Exception):  # whatever state the connection is in, it is not needed any more
            self._client.close(timeout=5)

    def _connect(self, wait: float | None = None) -> None:
        """Make sure of a client that runs."""
        wait = self._wait if wait is None else wait
        if self._client is not None and self._client.status == "running":
            return
        if self._client is not None:
            self._tell(f"waiting for the scheduler {self._address}, which is gone, up to {wait:.0f} s")
            self.close()
            self._client = None
        with self._explain(wait):
            self._client = self._distributed.Client(self._address, timeout=wait, set_as_default=False)

    @contextlib.contextmanager
    def _explain(self, wait: float) -> Iterator[None]:
        try:
            yield
        except (TimeoutError, OSError):
            what = "no scheduler answers" if self._client is None else "the cluster has no worker"
            raise BuildError(f"{self._address}: {what} within {wait:.0f} s") from None

    def _hand_over(self, remote: Any, local: Future[Any]) -> None:
        """Pass what became of a remote task on; runs in a thread of the client."""
        try:
            if remote.status == "finished":
                local.set_result(remote.result(timeout=self._wait))
            else:
                failure = remote.exception(timeout=self._wait) if remote.status == "error" else None
                local.set_exception(failure or _LostOnTheWayError("the scheduler was lost"))
        except BaseException as error:
            # Only the connection may fail without a limit; a result that cannot be unpacked here would do so for ever.
            gone = self._client is None or self._client.status != "running"
            lost = _LostOnTheWayError(f"{type(error).__name__}: {error}")
            local.set_exception(lost if gone or isinstance(error, _ON_THE_WAY) else error)


def check_address(address: str) -> None:
    """Refuse what cannot be the address of a scheduler; nothing is connected.

    A client of Dask that is given such an address never ends, not even with its program.

    Raises
    ------
    BuildError
        The package ``distributed`` is missing.
    SchedulerAddressError
        It has no port, or a protocol that this computer does not know.
    """
    comm = _import_distributed().comm
    try:
        scheme, place = comm.parse_address(address)
        comm.registry.get_backend(scheme)
        host, port = comm.parse_host_port(place) if scheme != "inproc" else (place, 1)
    except ValueError as error:
        raise SchedulerAddressError(address, f"is no address of a scheduler, tcp://host:8786 ({error})") from None
    if not host or not 0 < port < 2**16:
        rule = "is no address of a scheduler, tcp://host:8786 (it needs a host, and a port of 1 to 65535)"
        raise SchedulerAddressError(address, rule)


def _import_distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise BuildError("a cluster needs the package distributed: pip install 'jointplay[cluster]'") from None
    return distributed


class _LostOnTheWayError(Exception):
    """A task or its result was lost with the scheduler or the connection."""


@lru_cache
def _versions() -> dict[str, str]:
    return {"numbers": str(solver.NUMBERS_VERSION), **package_versions()}


def _at_worker(task: Callable[[A], R], argument: A, wanted: Mapping[str, str]) -> R:
    """What a worker does: check that its numbers are the builder's, and compute with one thread."""
    for name, version in _versions().items():
        if wanted.get(name) != version:
            raise BuildError(f"a worker of the cluster has {name} {version}, this builder {wanted.get(name)}")
    from threadpoolctl import threadpool_limits

    with _ONE_AT_A_TIME, threadpool_limits(1):
        return task(argument)
