"""Answers that take longer than a request may go on behind all others, and are told when they are asked for again."""

from __future__ import annotations

import asyncio
import os
import re
import signal
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
from long_work import fail, lack, refuse, work
from starlette.requests import Request

from jointplay.app.errors import TimeLimitError
from jointplay.app.http.handlers import handle
from jointplay.app.jobs import background, tasks, verification
from jointplay.app.jobs.answers import Answers
from jointplay.app.jobs.background import Background
from jointplay.app.jobs.clients import Client, working_for
from jointplay.app.jobs.workers import TaskFailedError, WorkerOutcome, WorkerPool
from jointplay.app.problems import problem_of
from jointplay.app.storage.store import Store
from jointplay.app.storage.told import Told
from jointplay.app.storage.uploads import Upload
from jointplay.catalogue.errors import DiagnosisError


def begun(folder: Path) -> list[list[str]]:
    """Process and niceness of everything that began."""
    file = folder / "begun"
    return [line.split() for line in file.read_text().splitlines()] if file.exists() else []


async def came_to(behind: Background, key: str) -> Any:
    made = await behind.wait(key, 120.0)
    assert made is not None
    return made.result()


async def until(reached: Callable[[], bool]) -> None:
    for _ in range(6000):
        if reached():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("it took too long")


def run(story: Callable[[Background], Coroutine[Any, Any, None]], time_limit: float = 300.0) -> None:
    async def whole() -> None:
        behind = Background(time_limit)
        try:
            await story(behind)
        finally:
            await behind.close()

    asyncio.run(whole())


def test_one_after_the_other_behind_all_others(tmp_path: Path) -> None:
    ended: list[str] = []
    folders = {key: tmp_path / key for key in ("first", "second")}
    for folder in folders.values():
        folder.mkdir()

    async def story(behind: Background) -> None:
        for key, folder in folders.items():
            assert behind.go_on(key, work, (folder,), lambda key=key: ended.append(key))  # type: ignore[misc]
            assert behind.say(key) == "it has begun"
        assert behind.go_on("first", work, (tmp_path,), lambda: ended.append("again")), "it is worked at already"
        assert ended == ["again"]
        await until(lambda: behind.say("first") == "768 of 9221 cases of this machine are simulated")
        assert behind.say("second") == "others are before it"
        assert not begun(folders["second"])
        assert await behind.wait("first", 0.05) is None
        assert behind.is_at_work("first")
        (folders["first"] / "go").touch()
        await until(lambda: behind.say("second") == "768 of 9222 cases of this machine are simulated")
        (folders["second"] / "go").touch()
        assert await came_to(behind, "second") == str(folders["second"])
        assert await came_to(behind, "first") == str(folders["first"]), "it is kept for whoever asks again"
        assert not behind.is_at_work("first")
        assert not behind.processes(), "none waits: its memory is given back"

    run(story)
    assert ended == ["again", "first", "second"]
    ((process, nice),), second = begun(folders["first"]), begun(folders["second"])
    assert second == [[process, nice]], "one process does it all"
    assert int(nice) == min(19, os.nice(0) + background.NICE)
    assert int(process) != os.getpid()


def test_too_many_are_not_begun_and_all_are_let_go_at_the_end(tmp_path: Path) -> None:
    ended: list[str] = []

    def go_on(behind: Background, key: str, client: str) -> bool:
        with working_for(Client(client)):
            return behind.go_on(key, work, (tmp_path,), lambda: ended.append(key))

    async def story(behind: Background) -> None:
        places = [(f"{client} {number}", client) for client in "abcd" for number in range(background.MOST_OF_ONE)]
        assert len(places) == background.MOST
        assert all(go_on(behind, key, client) for key, client in places[:-1])
        assert not go_on(behind, "a 3", "a"), "others have places, too"
        assert go_on(behind, *places[-1])
        assert not go_on(behind, "e 1", "e")
        assert not behind.is_at_work("e 1")
        assert ended == ["a 3", "e 1"], "what they held is let go"

    run(story)
    assert len(ended) == background.MOST + 2
    assert ended.count("a 0") == 1


def test_a_refusal_is_told_to_whoever_asks_again(tmp_path: Path) -> None:
    async def story(behind: Background) -> None:
        behind.go_on("refused", refuse, (tmp_path,))
        with pytest.raises(TaskFailedError, match="no column is a sensor"):
            await came_to(behind, "refused")

    run(story)


def test_its_log_names_the_task(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    background.attempt_in_sight("r1", fail, (tmp_path,))
    assert "task fail failed" in caplog.text


@pytest.mark.parametrize(("task", "said"), [(fail, r"entries\.h5: cannot be read"), (lack, r"worn\.csv.* is missing")])
def test_what_may_be_mended_is_logged_and_begun_anew(
    tmp_path: Path, task: Callable[..., Any], said: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def story(behind: Background) -> None:
        for _ in range(2):
            assert behind.go_on("bad", task, (tmp_path,))
            assert await behind.wait("bad", 120.0) is None
            assert not behind.is_at_work("bad")

    run(story)
    assert len(re.findall(f"is not gone on with: .*{said}", caplog.text)) == 2


def test_after_one_that_was_killed_the_next_has_a_process_of_its_own(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def story(behind: Background) -> None:
        behind.go_on("killed", work, (tmp_path,))
        await until(lambda: behind.say("killed").startswith("768 of"))
        ((_, killed),) = behind.processes()
        os.kill(killed, signal.SIGKILL)
        assert await behind.wait("killed", 120.0) is None
        behind.go_on("next", work, (tmp_path,))
        assert behind.say("next") == "it has begun", "not what the other left"
        await until(lambda: behind.say("next").startswith("768 of"))

    run(story)
    (killed, _), (later, _) = begun(tmp_path)
    assert killed != later
    assert len(re.findall("is not gone on with", caplog.text)) == 1


def test_what_takes_too_long_is_ended(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def story(behind: Background) -> None:
        for key in ("first", "second"):
            behind.go_on(key, work, (tmp_path,))
            assert await behind.wait(key, 120.0) is None
            assert not behind.processes()

    run(story, time_limit=0.5 / background.LIMITS)
    assert len(re.findall("is not gone on with: TimeoutError", caplog.text)) == 2


class Pool:
    """Takes too long, until it is told otherwise."""

    def __init__(self) -> None:
        self.in_time = False
        self.asked = 0

    async def run(self, task: Callable[..., Any], *args: Any) -> str:
        self.asked += 1
        if not self.in_time:
            raise TimeLimitError("stopped after 120 s, the time limit of this service")
        return "answered"


class Behind(Background):
    """Notes what it is to go on with, and does nothing."""

    def __init__(self) -> None:
        super().__init__(120.0)
        self.asked: list[tuple[str, Callable[..., Any], Sequence[Any], Callable[[], None]]] = []
        self.has_place = True
        self.at_work: set[str] = set()
        self.made: dict[str, WorkerOutcome] = {}

    def go_on(
        self, key: str, task: Callable[..., Any], args: Sequence[Any], done: Callable[[], None] = lambda: None
    ) -> bool:
        self.asked.append((key, task, args, done))
        self.at_work |= {key} if self.has_place else set()
        return self.has_place

    async def wait(self, key: str, seconds: float) -> WorkerOutcome | None:
        assert seconds in (60.0, 0.0), "the other half of two limits is for the answer itself"
        return self.made.get(key)

    def is_at_work(self, key: str) -> bool:
        return key in self.at_work


BASELINE = ("order.csv", "order.csv", Told(), None, None)
THOROUGH = tasks.DiagnosisTask("slider-crank", "", (None,), "thorough", "auto", {}, {}, (BASELINE,))
WORN = ("worn.csv", "worn.csv", Told())


def answers(data: Path) -> tuple[Answers, Pool, Behind]:
    pool, behind = Pool(), Behind()
    return Answers(cast(WorkerPool, pool), behind, Store(data).uploads, 120.0), pool, behind


def refusal(made: Answers, question: tasks.DiagnosisTask = THOROUGH, **also: Any) -> TimeLimitError:
    task = tasks.summarise_and_diagnose if also else tasks.diagnose
    with pytest.raises(TimeLimitError) as caught:
        asyncio.run(made.answer(task, *WORN, question=question, measurements=["m1"], **also))
    return caught.value


def test_it_goes_on_and_is_answered_when_asked_again(tmp_path: Path) -> None:
    made, pool, behind = answers(tmp_path)
    told = problem_of(refusal(made))
    assert (told.status, told.headers["Retry-After"]) == (504, "120")
    assert told.detail.startswith("stopped after 120 s, the time limit of this service; it goes on in the background")
    assert [each[1:3] for each in behind.asked] == [(tasks.diagnose, (*WORN, THOROUGH))]
    assert str(refusal(made)).startswith("it takes longer than a request may; it goes on in the background")
    assert (pool.asked, len(behind.asked)) == (1, 1), "no worker does what is done already"
    behind.made[behind.at_work.pop()] = WorkerOutcome("made meanwhile")
    assert asyncio.run(made.answer(tasks.diagnose, *WORN, question=THOROUGH, measurements=["m1"])) == "made meanwhile"
    assert pool.asked == 1


@pytest.mark.parametrize(
    ("task", "question", "measurement"),
    [
        (tasks.diagnose, THOROUGH, "m2"),
        (tasks.diagnose, replace(THOROUGH, speeds=(3.0,)), "m1"),
        (tasks.diagnose_together, THOROUGH, "m1"),
        (tasks.summarise_and_diagnose, THOROUGH, "m1"),
    ],
)
def test_other_questions_do_not_wait_for_it(
    tmp_path: Path, task: Callable[..., Any], question: tasks.DiagnosisTask, measurement: str
) -> None:
    made, pool, _ = answers(tmp_path)
    refusal(made)
    pool.in_time = True
    said = asyncio.run(made.answer(task, *WORN, question=question, measurements=[measurement]))
    assert said == "answered"


def test_what_was_made_while_a_worker_was_at_it_is_answered(tmp_path: Path) -> None:
    made, pool, behind = answers(tmp_path)
    refusal(made)
    (key,) = behind.at_work

    async def run_long(task: Callable[..., Any], *args: Any) -> str:
        behind.made[key] = WorkerOutcome("made meanwhile")
        raise TimeLimitError("stopped")

    behind.at_work.clear()
    pool.run = run_long  # type: ignore[method-assign]
    assert asyncio.run(made.answer(tasks.diagnose, *WORN, question=THOROUGH, measurements=["m1"])) == "made meanwhile"
    assert len(behind.asked) == 1


def test_what_lies_only_as_long_as_its_request_is_held(tmp_path: Path) -> None:
    made, _, behind = answers(tmp_path)
    file = tmp_path / "partial-1"
    file.write_bytes(b"t,ax\n")
    refusal(made, upload=Upload(file, "", 5))
    ((_, task, (held, *told), done),) = behind.asked
    assert (task, told) == (tasks.summarise_and_diagnose, [*WORN[1:], THOROUGH])
    assert held != str(file)
    assert Path(held).read_bytes() == b"t,ax\n"
    done()
    assert not Path(held).exists()
    assert file.exists(), "whoever sent it settles it"


@pytest.mark.parametrize("together", [False, True])
def test_an_answer_is_made_again_in_sight(monkeypatch: pytest.MonkeyPatch, together: bool) -> None:
    """A verification goes on in the background as its diagnosis did, and says how far it is."""

    def diagnose(*args: Any) -> None:
        args[-1](768, 9216)
        raise DiagnosisError("worn.csv: no column is a sensor")

    monkeypatch.setattr(tasks, "diagnose_together" if together else "diagnose", diagnose)
    told: list[tuple[int, int]] = []
    again = verification.Again({"recordings": [1] if together else []}, (WORN,), THOROUGH)
    with pytest.raises(DiagnosisError, match="no column is a sensor"):  # and is not kept, where it may be mended
        verification.repeat(again.then, again.recordings, again.question, lambda *done: told.append(done))
    assert told == [(768, 9216)]


def test_what_goes_on_is_no_error_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "jointplay")
    scope = {"type": "http", "path": "/api/v1/diagnoses", "headers": []}
    errors = TimeLimitError("stopped; it goes on", 120), TimeLimitError("stopped")
    answered = [asyncio.run(handle(Request(scope), error)) for error in errors]
    assert [(each.status_code, each.headers.get("retry-after")) for each in answered] == [(504, "120"), (504, None)]
    assert [(each.levelname, each.message) for each in caplog.records if "stopped" in each.message] == [
        ("INFO", "stopped; it goes on"),
        ("ERROR", "stopped"),
    ]


def test_where_too_many_wait_and_of_what_takes_seconds_nothing_goes_on(tmp_path: Path) -> None:
    made, pool, behind = answers(tmp_path)
    fast = replace(THOROUGH, effort="fast")
    assert str(refusal(made, fast)) == "stopped after 120 s, the time limit of this service"
    assert not behind.asked
    behind.has_place = False
    for _ in range(2):
        said = refusal(made)
        assert str(said) == "stopped after 120 s, the time limit of this service"
        assert "Retry-After" not in said.headers
    assert pool.asked == 3
