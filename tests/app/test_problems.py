"""Every class of the exception trees has its own row in the table of problems."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import jointplay.app.errors
import jointplay.catalogue.errors
import jointplay.solver.errors
from jointplay.app import problems


def tree(root: type[Exception]) -> Iterator[type[Exception]]:
    yield root
    for child in root.__subclasses__():
        yield from tree(child)


ROOTS = (jointplay.app.errors.AppError, jointplay.catalogue.errors.CatalogueError, jointplay.solver.errors.SolverError)
CLASSES = sorted({cls for root in ROOTS for cls in tree(root)}, key=lambda cls: cls.__qualname__)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_every_class_has_its_own_row(cls: type[Exception]) -> None:
    assert cls in problems.TABLE


def test_rows_are_distinct_and_of_known_classes() -> None:
    assert set(problems.TABLE) == set(CLASSES)
    slugs = [kind.slug for kind in problems.TABLE.values()]
    assert len(set(slugs)) == len(slugs)


def test_an_unforeseen_exception_tells_nothing_of_itself() -> None:
    problem = problems.problem_of(KeyError("/secret/path"))
    assert problem.status == 500
    assert "secret" not in problem.detail
    assert problems.exit_status(KeyError("x")) == 1


def test_a_field_is_named() -> None:
    problem = problems.problem_of(jointplay.app.errors.BadFieldError("speed: 0: must be greater than 0", field="speed"))
    assert problem.document("/api/v1/diagnoses") == {
        "type": "urn:jointplay:problem:invalid-field",
        "title": "A field breaks a rule",
        "status": 422,
        "detail": "speed: 0: must be greater than 0",
        "instance": "/api/v1/diagnoses",
        "errors": [{"field": "speed", "message": "speed: 0: must be greater than 0"}],
    }


def test_what_cannot_be_sent_is_written_out() -> None:
    problem = problems.problem_of(jointplay.app.errors.BadFieldError("name: \ud800\n: is odd", field="name"))
    assert problem.detail == problem.errors[0]["message"] == "name: \\ud800 : is odd"


def test_a_busy_service_says_when_to_come_back() -> None:
    assert problems.problem_of(jointplay.app.errors.BusyError("busy")).headers == {"Retry-After": "5"}


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (jointplay.solver.errors.MachineError("m.yaml", "links", None, "is missing"), 2),
        (jointplay.catalogue.errors.CatalogueBusyError("somewhere"), 1),
        (jointplay.app.errors.SimulationFailedError("diverged"), 1),
        (jointplay.app.errors.OutputError("x.txt: must end in .h5"), 2),
    ],
)
def test_exit_status(error: Exception, status: int) -> None:
    assert problems.exit_status(error) == status
