"""Whose task is next where several clients wait for workers, and whose is refused where too many wait."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Generic, TypeVar

from jointplay.app.errors import BusyError

Worker = TypeVar("Worker")


class Turns(Generic[Worker]):
    """A lane for each client, served in turn.

    Next is whoever has fewest tasks with workers, and of these whoever had a turn longest ago. Where all places are
    taken, the last of the longest lane is refused, so that no client keeps another out.

    Parameters
    ----------
    limit : int
        Number of tasks that may wait.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._lanes: dict[str, list[asyncio.Future[Worker]]] = {}
        self._working: Counter[str] = Counter()
        self._turns = 0
        self._last: dict[str, float] = {}

    def __len__(self) -> int:
        """Return the number of tasks that wait."""
        return sum(map(len, self._lanes.values()))

    def join(self, client: str) -> asyncio.Future[Worker]:
        """Return a place in a client's lane: it gets a worker, or a refusal when others need the place more.

        Raises
        ------
        BusyError
            When too many tasks wait, and no client has more of them.
        """
        if len(self) >= self._limit:
            refusal = BusyError(f"{len(self)} requests wait for a worker already; try again in a few seconds")
            longest = max(self._lanes, key=lambda each: len(self._lanes[each]), default=client)
            if len(self._lanes.get(longest, ())) <= len(self._lanes.get(client, ())) + 1:
                raise refusal
            last = self._lanes[longest][-1]
            self.leave(longest, last)
            last.set_exception(refusal)
        place: asyncio.Future[Worker] = asyncio.get_running_loop().create_future()
        self._lanes.setdefault(client, []).append(place)
        # Who is new comes after those that have waited until now, so that new ones without end keep nobody waiting.
        self._last.setdefault(client, self._turns - 0.5)
        return place

    def leave(self, client: str, place: asyncio.Future[Worker]) -> None:
        """Give a place up."""
        lane = self._lanes.get(client, [])
        if place in lane:
            lane.remove(place)
        if not lane:
            self._lanes.pop(client, None)

    def serve(self, worker: Worker) -> bool:
        """Give a worker to whoever is next; return whether anybody was."""
        if not self._lanes:
            return False
        client = min(self._lanes, key=lambda each: (self._working[each], self._last[each]))
        place = self._lanes[client][0]
        self.leave(client, place)
        place.set_result(worker)
        self.begin(client)
        return True

    def begin(self, client: str) -> None:
        """Take note that a client has got a worker."""
        self._turns += 1
        self._working[client] += 1
        self._last[client] = self._turns

    def end(self, client: str) -> None:
        """Take note that a client's task has left its worker; who has none and waits for none is forgotten."""
        self._working[client] -= 1
        for each in [name for name in self._last if not self._working[name] and name not in self._lanes]:
            del self._last[each], self._working[each]
