"""However many follow a build, it is looked at once; who comes later learns at once how it is."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from typing import Any, cast

import pytest
from sqlalchemy.exc import OperationalError

from jointplay.app.errors import RateLimitedError, UnknownBuildError
from jointplay.app.jobs import build_watch
from jointplay.app.jobs.build_watch import BuildWatch
from jointplay.app.storage.build_queue import BuildQueue, BuildRow
from jointplay.app.storage.rows import now


class Queue:
    """One build, and how often it was looked at."""

    def __init__(self) -> None:
        self.looks = 0
        self.created_at = now()
        self.cases_done = 0
        self.state = "running"
        self.trouble: Exception | None = None

    def row(self) -> BuildRow:
        named = {"id": "b", "plan_hash": "0", "catalogue": "c", "catalogue_id": None, "workers": 1, "message": ""}
        moments = {"created_at": self.created_at, "started_at": None, "ended_at": None}
        counts = {"cases_total": 9, "rate_per_s": 0.0, "seconds_left": None, "attempts": 1}
        things = {"machine": {"name": "m"}, "plan": {"name": "p"}}
        how = {"state": self.state, "cases_done": self.cases_done}
        return BuildRow(**named, **moments, **counts, **things, **how)

    def find(self, key: str) -> BuildRow:
        self.looks += 1
        trouble, self.trouble = self.trouble, None
        if trouble is not None:
            raise trouble
        return self.row()


@pytest.fixture
def queue(monkeypatch: pytest.MonkeyPatch) -> Queue:
    monkeypatch.setattr(build_watch, "LOOK_S", 0.02)
    return Queue()


def watch_of(queue: Queue, stopping: threading.Event | None = None) -> BuildWatch:
    return BuildWatch(cast(BuildQueue, queue), stopping or threading.Event())


def state_of(event: str) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(event.split("data: ")[1])
    return said


def test_three_hundred_listeners_are_one_look(queue: Queue) -> None:
    async def story() -> None:
        watch, moment = watch_of(queue), time.monotonic()
        streams = [watch.follow(queue.row(), moment) for _ in range(300)]
        for stream in streams:
            assert state_of(await anext(stream))["cases_done"] == 0
        listening = [asyncio.ensure_future(anext(stream)) for stream in streams]
        await asyncio.sleep(0)
        before = queue.looks
        while queue.looks < before + 3:
            await asyncio.sleep(0.01)
        assert not any(each.done() for each in listening)
        queue.cases_done, looks = 5, queue.looks
        assert {state_of(await each)["cases_done"] for each in listening} == {5}
        assert queue.looks - looks <= 2  # one was under way
        queue.state = "done"
        assert {state_of(await anext(stream))["state"] for stream in streams} == {"done"}
        for stream in streams:
            with pytest.raises(StopAsyncIteration):
                await anext(stream)
        assert (watch._watched, watch._tasks) == ({}, {})

    asyncio.run(story())


def test_what_was_seen_before_the_present_state_is_not_told_after_it(queue: Queue) -> None:
    async def story() -> None:
        watch, moment = watch_of(queue), time.monotonic()
        early, queue.cases_done = queue.row(), 5
        stream = watch.follow(queue.row(), moment)
        assert state_of(await anext(stream))["cases_done"] == 5
        watch._watched["b"].tell(early, moment - 1.0)
        assert state_of(watch_text(watch))["cases_done"] == 5
        await stream.aclose()

    asyncio.run(story())


def watch_text(watch: BuildWatch) -> str:
    return f"data: {watch._watched['b'].text}"


def test_listeners_hear_that_it_lives_and_outlast_a_database_that_does_not_answer(
    queue: Queue, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(build_watch, "HEARTBEAT_S", 0.03)

    async def story() -> None:
        watch = watch_of(queue)
        stream = watch.follow(queue.row(), time.monotonic())
        await anext(stream)
        queue.trouble = OperationalError("SELECT", {}, Exception("gone"))
        while queue.trouble is not None:
            assert await anext(stream) == ": alive\n\n"
        queue.cases_done = 7
        while (event := await anext(stream)).startswith(": alive"):
            pass
        assert state_of(event)["cases_done"] == 7
        queue.trouble = UnknownBuildError("b: there is none of this id")
        assert {event async for event in stream} <= {": alive\n\n"}

    asyncio.run(story())
    assert "cannot be followed" in caplog.text


def test_streams_end_when_the_service_stops(queue: Queue) -> None:
    async def story() -> None:
        stopping = threading.Event()
        stream = watch_of(queue, stopping).follow(queue.row(), time.monotonic())
        await anext(stream)
        stopping.set()
        with pytest.raises(StopAsyncIteration):
            await anext(stream)

    asyncio.run(story())


def test_places_are_counted_and_given_back(queue: Queue) -> None:
    watch = watch_of(queue)
    for _ in range(build_watch.MOST_OF_ONE):
        watch.enter("one")
    with pytest.raises(RateLimitedError, match="50 streams of events are open already"):
        watch.enter("one")
    watch.enter("other")
    watch.leave("one")
    watch.enter("one")
