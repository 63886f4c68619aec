"""What all lanes do alike between two steps, its printed code run as Python."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fuzz.scalar_block import HEAD, ScalarBlock

from jointplay.solver.compiler.rows import WorkRows, work_rows
from jointplay.solver.integrators import between
from jointplay.solver.integrators.control import switch_part

CONTACTS = 2


@pytest.fixture
def rows() -> WorkRows[range]:
    counts = dict.fromkeys(("touching", "switch", "penetration", "approach"), CONTACTS)
    return work_rows(
        2, 0, 0, 1, **counts, begun=3 * CONTACTS, suspect=1, taken=1, slopes=4, last_slopes=2, stage_pulls=3
    )


def run(monkeypatch: pytest.MonkeyPatch, rows: WorkRows[range], name: str, w: list[float]) -> None:
    monkeypatch.setattr(between, "Block", ScalarBlock)
    space: dict[str, Any] = {}
    exec(HEAD + getattr(between, f"{name}_step")(rows), space)
    space[name](w)


def test_lanes_with_a_switch_are_suspects(monkeypatch: pytest.MonkeyPatch, rows: WorkRows[range]) -> None:
    """Whatever switch_part finds is looked at; few others are."""
    rng, step, found, looked = np.random.default_rng(1), 1e-4, 0, 0
    for _ in range(500):
        w, switched = [0.0] * rows.hoisted.stop, False
        w[rows.step[0]] = step
        for j in range(CONTACTS):
            pushing = bool(rng.integers(2))
            p0, p1 = rng.normal(0.1 if pushing else -0.1, 1.0, 2) * 10 ** rng.uniform(-7, -5)
            r0, r1 = rng.normal(0.0, 0.1, 2)
            s0, s1 = (min(p, p + 3e-5 * r) for p, r in ((p0, r0), (p1, r1)))
            w[rows.touching[j]] = float(pushing)
            for k, (before, after) in enumerate(((s0, s1), (p0, p1), (r0, r1))):
                w[rows.begun[k * CONTACTS + j]] = before
                w[(rows.switch, rows.penetration, rows.approach)[k][j]] = after
            switched = switched or switch_part(pushing, s0, s1, p0, p1, r0, r1, step) <= 1.0
        run(monkeypatch, rows, "suspect", w)
        assert w[rows.suspect[0]] == 1.0 or not switched
        found, looked = found + switched, looked + int(w[rows.suspect[0]])
    assert 50 < found <= looked < 1.2 * found


@pytest.mark.parametrize("taken", [0.0, 1.0])
def test_a_step_is_taken_on_or_back(monkeypatch: pytest.MonkeyPatch, rows: WorkRows[range], taken: float) -> None:
    w = [float(i) for i in range(rows.hoisted.stop)]
    w[rows.taken[0]] = taken
    run(monkeypatch, rows, "advance", w)
    state = (*rows.z, *rows.v, *rows.bristles)
    begin = (*rows.slopes[:2], *rows.begun, *rows.stage_pulls[:1])
    ends = (*rows.last_slopes, *rows.switch, *rows.penetration, *rows.approach, *rows.pull)
    assert [w[i] for i in state] == [*(state if taken else (*rows.kept, *rows.kept_bristles))]
    assert [w[i] for i in begin] == [*(ends if taken else begin)]
