"""Workers go to clients in turn, and a full queue refuses whoever has most in it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from jointplay.app.errors import BusyError
from jointplay.app.jobs.turns import Turns

Places = list[asyncio.Future[str]]


def told(story: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(story())


def order(turns: Turns[str], places: dict[str, Places], workers: int = 1) -> list[str]:
    """Whose tasks are served, one after the other, when all take as long as each other."""
    waiting = [(client, place) for client, lane in places.items() for place in lane]
    at_work: list[str] = []
    served: list[str] = []
    while True:
        while len(at_work) < workers and turns.serve("worker"):
            (client,) = [each for each, place in waiting if place.done()]
            waiting = [pair for pair in waiting if not pair[1].done()]
            at_work.append(client)
            served.append(client)
        if not at_work:
            return served
        turns.end(at_work.pop(0))


def test_one_of_another_does_not_wait_for_fifty_of_one() -> None:
    async def story() -> None:
        turns: Turns[str] = Turns(100)
        places = {"first": [turns.join("first") for _ in range(50)], "second": [turns.join("second")]}
        served = order(turns, places)
        assert (served.index("second"), len(served), len(turns)) == (1, 51, 0)

    told(story)


def test_clients_take_turns_and_the_tasks_of_one_keep_their_order() -> None:
    async def story() -> None:
        turns: Turns[str] = Turns(100)
        places = {name: [turns.join(name) for _ in range(count)] for name, count in (("a", 4), ("b", 2), ("c", 1))}
        assert order(turns, places) == ["a", "b", "c", "a", "b", "a", "a"]
        lane = [turns.join("a") for _ in range(2)]
        assert turns.serve("worker")
        assert [place.done() for place in lane] == [True, False]

    told(story)


def test_who_has_a_worker_already_comes_after_who_has_none() -> None:
    async def story() -> None:
        turns: Turns[str] = Turns(100)
        places = {"a": [turns.join("a") for _ in range(4)], "b": [turns.join("b") for _ in range(2)]}
        assert order(turns, places, workers=2)[:4] == ["a", "b", "a", "b"]

    told(story)


def test_new_clients_without_end_keep_nobody_waiting() -> None:
    async def story() -> None:
        turns: Turns[str] = Turns(100)
        mine = [turns.join("mine") for _ in range(3)]
        served = 0
        for number in range(20):
            place = turns.join(f"new-{number}")
            assert turns.serve("worker")
            served += 1
            turns.end(f"new-{number}" if place.done() else "mine")
            if mine[2].done():
                break
        assert mine[2].done()
        assert served <= 6

    told(story)


def test_a_full_queue_refuses_the_last_of_the_longest_lane() -> None:
    async def story() -> None:
        turns: Turns[str] = Turns(4)
        first = [turns.join("first") for _ in range(4)]
        with pytest.raises(BusyError, match="4 requests wait for a worker already"):
            turns.join("first")
        others = [turns.join("second"), turns.join("third")]
        assert [place.done() for place in (*first, *others)] == [False, False, True, True, False, False]
        with pytest.raises(BusyError, match="wait for a worker"):
            first[3].result()
        with pytest.raises(BusyError, match="wait for a worker"):
            first[2].result()
        with pytest.raises(BusyError):  # the longest has but one more
            turns.join("second")
        assert len(turns) == 4

    told(story)


def test_who_has_nothing_any_more_is_forgotten() -> None:
    async def story() -> None:
        turns: Turns[str] = Turns(1000)
        for number in range(500):
            turns.join(str(number))
            assert turns.serve("worker")
            turns.end(str(number))
        left = turns.join("left")
        turns.leave("left", left)
        turns.join("last")
        assert turns.serve("worker")
        turns.end("last")
        assert (len(turns._last), len(turns._working), len(turns._lanes)) == (0, 0, 0)

    told(story)
