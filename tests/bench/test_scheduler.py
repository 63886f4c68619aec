"""The simulated build: its laws, and cases that can be worked out by hand."""

from __future__ import annotations

import pytest

from benchmarks.scheduler import Costs, Fleet, simulated

FREE = Costs(chunks=(1.0,), compile=0.0, start=0.0, store=0.0, transaction=0.0, wire=0.0)


def test_without_any_cost_but_the_cases() -> None:
    found = simulated(Fleet(4, chunks=40), FREE)
    assert found.seconds == pytest.approx(10.0)
    assert found.busy == pytest.approx(1.0)
    assert found.builder == 0.0
    assert found.begun == 40


def test_one_worker_compiles_every_model_once() -> None:
    costs = Costs(chunks=(1.0,), compile=0.5, start=3.0, store=0.0, transaction=0.0, wire=0.0)
    found = simulated(Fleet(1, chunks=12, models=4), costs)
    assert found.seconds == pytest.approx(3.0 + 12 * 1.0 + 4 * 0.5)


def test_a_builder_that_has_too_many_workers_sets_the_pace() -> None:
    """Each chunk costs it 30 ms and two transactions of 5 ms: 25 a second, whatever the number of workers."""
    costs = Costs(chunks=(1.0,), compile=0.0, start=0.0, store=0.03, transaction=0.005, wire=0.0)
    found = simulated(Fleet(500, chunks=2500), costs)
    assert found.seconds == pytest.approx(100.0, rel=0.02)
    assert found.builder > 0.97
    assert found.transactions == pytest.approx(50.0, rel=0.02)
    four = simulated(Fleet(500, cells=4, chunks=625), costs)
    assert four.seconds == pytest.approx(25.0, rel=0.1)


def test_the_database_sets_the_pace_of_many_builders() -> None:
    costs = Costs(chunks=(0.1,), compile=0.0, start=0.0, store=0.0, transaction=0.01, wire=0.0)
    found = simulated(Fleet(400, cells=40, chunks=100, slots=2), costs)
    assert found.transactions == pytest.approx(200.0, rel=0.02)  # two at a time, 10 ms each


def test_chunks_of_workers_that_died_are_begun_again() -> None:
    costs = Costs(chunks=(1.0,), compile=0.0, start=1.0, store=0.0, transaction=0.0, wire=0.0)
    calm = simulated(Fleet(10, chunks=1000), costs)
    deadly = simulated(Fleet(10, chunks=1000, deaths=60.0), costs)  # one a minute and worker
    assert calm.begun == 1000
    assert 1010 <= deadly.begun <= 1030  # some 17 deaths in 100 s of ten workers
    assert 1.01 < deadly.seconds / calm.seconds < 1.1
