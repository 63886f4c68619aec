"""What happens between two error-controlled steps in all lanes alike, as straight-line code.

A lane at a time, the copying and the looking for contacts cost as much as the right-hand sides of a step. So the driver
(:mod:`jointplay.solver.integrators.adaptive`) leaves all that is the same for every lane to these functions, and looks
closer where something is found.
"""

from __future__ import annotations

from collections.abc import Iterable

from jointplay.solver.compiler.ir import Block
from jointplay.solver.compiler.rows import WorkRows

#: Pairs of rows: what a step has left, and where the next one reads it.
_Pairs = Iterable[tuple[int, int]]


def _left(rows: WorkRows[range]) -> _Pairs:
    """What the contacts and bristles of a step's end are, and where those of its beginning stand."""
    sticking = len(rows.pull)
    ends = (*rows.switch, *rows.penetration, *rows.approach, *rows.pull)
    return zip(ends, (*rows.begun, *rows.stage_pulls[:sticking]), strict=True)


def begin_step(rows: WorkRows[range]) -> str:
    """``begin``: slopes, contacts and bristles at the start of a step from the state alone."""
    block = Block()
    block.invoke("held")
    for row, target in (*zip(rows.a, rows.slopes, strict=False), *_left(rows)):
        block.store(target, block.load(row))
    return block.function("begin")


def suspect_step(rows: WorkRows[range]) -> str:
    """``suspect``: 1 in lanes of which a contact may have begun, ended, or come near within the step, else 0.

    Where it is 0, :func:`jointplay.solver.integrators.control.switch_part` finds nothing.
    """
    block = Block()
    zero, h = block.constant(0.0), block.load(rows.step[0])
    count = len(rows.touching)
    suspects = [block.compare("one", zero, zero)]
    for j in range(count):
        _, p0, r0 = (block.load(rows.begun[k * count + j]) for k in range(3))
        s1, p1, r1 = (block.load(place[j]) for place in (rows.switch, rows.penetration, rows.approach))
        pushing = block.compare("ogt", block.load(rows.touching[j]), block.constant(0.5))
        # Out on one side and in on the other: both ends, gone on with straight, are outside in between.
        across = block.sub(block.mul(p0, r1), block.mul(p1, r0))
        apart = block.compare("olt", across, block.neg(block.mul(h, block.mul(r0, r1))))
        parting, closing = block.compare("olt", r0, zero), block.compare("ogt", r1, zero)
        through = block.combine("and", block.combine("and", parting, closing), apart)
        ended = block.combine("or", block.compare("olt", s1, zero), through)
        near = block.combine("and", block.compare("ogt", r0, zero), block.compare("olt", r1, zero))
        near = block.combine("and", near, block.compare("olt", p0, zero))
        began = block.combine("or", block.compare("ogt", s1, zero), near)
        ended = block.combine("and", pushing, ended)
        suspects.append(block.combine("or", ended, block.combine("and", block.negate(pushing), began)))
    found = suspects[0]
    for each in suspects[1:]:
        found = block.combine("or", found, each)
    block.store(rows.suspect[0], block.select(found, block.constant(1.0), zero))
    return block.function("suspect")


def advance_step(rows: WorkRows[range]) -> str:
    """``advance``: lanes whose step was taken begin the next one where it ended, others where it began."""
    block = Block()
    taken = block.compare("ogt", block.load(rows.taken[0]), block.constant(0.5))
    back = zip((*rows.kept, *rows.kept_bristles), (*rows.z, *rows.v, *rows.bristles), strict=True)
    for row, state in back:
        block.store(state, block.select(taken, block.load(state), block.load(row)))
    for row, target in (*zip(rows.last_slopes, rows.slopes, strict=False), *_left(rows)):
        block.store(target, block.select(taken, block.load(row), block.load(target)))
    return block.function("advance")
