"""A hundred random machines with odd numbers, without compilation, and some through the compiled lanes."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace

import pytest
from fuzz.judge import judge
from fuzz.machines import Scene, scene
from fuzz.uncompiled import uncompiled

#: Smaller and shorter than in `make fuzz`: the oracle's time grows with the cube of the links, and with the horizon, s.
MOST_LINKS = 7
HORIZON = 0.001
ENDINGS = {"ok", "refused", "cannot_assemble", "jammed", "step_too_small", "diverged"}


def small_scenes(first: int, count: int) -> list[Scene]:
    """Scenes of the first small machines from seed `first` on."""
    small = (drawn for drawn in map(scene, itertools.count(first)) if len(drawn.machine.links) <= MOST_LINKS)
    return [replace(drawn, duration=min(HORIZON, drawn.duration)) for drawn in itertools.islice(small, count)]


@pytest.mark.long
@pytest.mark.parametrize("first", range(10_000, 10_500, 100))
def test_random_machines(first: int) -> None:
    """Right by the oracle, refused, or a named failure; `make fuzz` draws larger ones and watches them for longer."""
    found: Counter[str] = Counter()
    for drawn in small_scenes(first, 20):
        with uncompiled(trials=400):
            verdict = judge(drawn, evaluations=250)
        assert verdict.ending.partition(",")[0] in ENDINGS, (drawn.seed, verdict)
        found[verdict.ending] += 1
        found["confirmed"] += verdict.confirmed
    assert found["confirmed"] >= 3, found


def test_compiled_lanes() -> None:
    confirmed = 0
    for drawn in small_scenes(20_000, 8):
        confirmed += judge(drawn, evaluations=250).confirmed
    assert confirmed >= 2


@pytest.mark.parametrize("seed", [83, 134, 238])
def test_surfaces_of_which_neither_can_move(seed: int) -> None:
    """Their mobility is rounding, of either sign."""
    drawn = scene(seed)
    with uncompiled(trials=400):
        verdict = judge(replace(drawn, duration=min(HORIZON, drawn.duration)), evaluations=250)
    assert "is without effect: other joints leave it no play" in verdict.message


def test_no_change_point_where_nothing_curves() -> None:
    """A block that nothing holds along its line: what its closures lack is no saddle, but rounding."""
    with uncompiled(trials=400):
        verdict = judge(scene(448), evaluations=250)
    assert verdict.ending == "cannot_assemble"
    assert verdict.message.endswith("stays 1.55 mm open")
