"""A small share of ``make schemathesis``: every operation, what the document allows and what it forbids."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from small_service import serving

from benchmarks.api_fuzz import Found, copied, run
from jointplay.app.settings import ServiceSettings


@pytest.mark.long
def test_every_operation_answers_as_documented(shelf: Path, tmp_path: Path) -> None:
    settings = ServiceSettings(
        catalogues=copied(shelf, tmp_path),
        data=tmp_path / "data",
        max_upload_mb=1.0,
        workers=1,
        builds=0,
        keys="off",
        rate_burst=1e6,
    )
    with serving(settings) as address:
        found = run(address, examples=1, phases="examples,coverage,stateful")
    assert found.whole, found.output
    assert found.calls > 10 * found.operations, found.output


def test_a_run_that_reached_nothing_is_no_success() -> None:
    members = {"calls": 90, "operations": 9, "tested": 9, "failures": 0, "exit_status": 0}
    succeeded = Counter({f"GET /{number}": 1 for number in range(9)})
    assert Found(output="", succeeded=succeeded, **members).whole
    for broken in ({"tested": 8}, {"failures": 1}, {"exit_status": 1}, {"operations": 0, "tested": 0}):
        assert not Found(output="", succeeded=succeeded, **{**members, **broken}).whole
    assert not Found(output="", succeeded=succeeded - Counter({"GET /3": 1}), **members).whole
