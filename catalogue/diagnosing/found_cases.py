"""Cases that are simulated for one recording: drawn as those of a plan are, with what recordings have told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from jointplay.catalogue.building.chunk import cut_chunks, simulate_chunk
from jointplay.catalogue.building.executors import count_processors
from jointplay.catalogue.diagnosing.drawn_mounts import loosen, warm
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.diagnosing.stroke_loads import FoundLoad
from jointplay.catalogue.diagnosing.told import ToldNumbers
from jointplay.catalogue.matching.model_library import one_thread
from jointplay.catalogue.plans.cases import Numbers, entries_of
from jointplay.catalogue.plans.driving import DRIVE_SPEED
from jointplay.catalogue.plans.entry import Entry, Recipe, seed_from
from jointplay.catalogue.plans.parameters import ripple_order
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.plans.plan_parts import Distribution, DrawCounts, default_wide
from jointplay.catalogue.plans.variants import LawChoice
from jointplay.catalogue.storage.cross_power import pack, pack_cyclic
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine, has_known_effort

DOUBT = 2.0
"""How many times as far as in other files the frame and its mounts are off in the file of a machine that is doubted."""

CONTACT_DOUBT = 1.5
"""The same of stiffness and damping of all contacts together."""

ALIKE = 0.8
"""Correlation of the contacts of joints of such a machine, which are made of one material and have one oil: those that
joints have by themselves leave a quarter in stiffness."""

CHUNK = 96
"""Cases of a set that are simulated together, in one thread: so a set of 576 keeps six processors busy. Chunks of 384
take 7 % less time on two."""


def draw_cases(
    catalogue: Catalogue,
    speed: float,
    sets: Sequence[tuple[str, ...]],
    load: FoundLoad | None,
    count: int,
    *,
    doubted: bool = False,
    told: ToldNumbers | None = None,
    to_come: bool = False,
) -> tuple[Machine, list[Entry]]:
    """Draw so many cases of each set of worn joints, at a speed [rad/s].

    Parameters
    ----------
    catalogue : Catalogue
    speed : float
        rad/s.
    sets : sequence of tuple of str
        Worn joints; none for the machine in order.
    load : FoundLoad or None
        That the machine has.
    count : int
        Cases of each set.
    doubted : bool
        Whether frame, mounts and contacts may be off further than in a catalogue's trusted draws, the contacts of all
        joints together, and the drive ripples.
    told : ToldNumbers, optional
        In place of what is drawn of these numbers.
    to_come : bool
        Whether they are of days to come, on which the machine turns about that speed, as the machines of the catalogue
        do about theirs, its mounts are warmer or colder, and one of them may have come loose.

    Returns
    -------
    (Machine, list of Entry)
        The machine that the cases are of.
    """
    machine = catalogue.machine if load is None else load.machine(catalogue.machine)
    plan = catalogue.plan.resolve(machine)
    plan = plan.model_copy(
        update={
            "hypotheses": () if all(sets) else ("healthy",),
            "sets": tuple(filter(None, sets)),
            "draws": DrawCounts(healthy=count, single=count, pair=count, larger=count),
            # Machines whose other joints are ideal would each need a model of their own.
            "fits": plan.fits.model_copy(update={"silent": 0.0}),
            "wide": plan.wide.model_copy(update={"draws": 0.0}),
            "uncertain": _doubtful(plan, machine) if doubted else plan.uncertain,
            "speeds": (speed / catalogue.recipe.nominal_drive_speed if to_come else 1.0,),
            "loads": None,
            "guard": 0,
            "laws": told.contacts.laws if told and told.contacts else plan.laws,
        }
    )
    # What a motor turns at follows from its numbers, which are drawn.
    turned = {} if to_come or has_known_effort(machine) else {DRIVE_SPEED: speed}
    as_told = [told.draw(number) if told else {} for number in range(count)]

    def change(label: str, number: int, law: LawChoice, drawn: Numbers) -> Numbers:
        parameters = {**drawn, **turned, **as_told[number]}
        if told and told.contacts:
            parameters |= told.contacts.draw(law, number, drawn)
        if to_come:
            parameters |= warm(machine, parameters, label, number)
            parameters |= loosen(machine, parameters, label, number)
        if load is not None:
            generator = np.random.default_rng(seed_from("load as found", label, number))
            parameters |= dict(zip(load.paths, load.draw(generator.normal(size=2)).tolist(), strict=True))
        return parameters

    return machine, list(entries_of(plan, machine, change, alike=ALIKE if doubted else 0.0))


def on_a_day(entry: Entry, machine: Machine, recipe: Recipe) -> Entry:
    """Return the machine of a case as it is on some day, its mounts warmer or colder than they usually are."""
    numbers = {**entry.parameters, **warm(machine, entry.parameters, entry.hypothesis.label, entry.draw)}
    return changed(entry, machine, recipe, entry.clearances, numbers)


def _doubtful(plan: Plan, machine: Machine) -> dict[str, Distribution]:
    """What is drawn of a machine that is not as its file says."""
    assert plan.uncertain is not None  # a plan without open ends
    own = ("frame.", f"links.{machine.frame}.", "supports.", "modes.")
    wider = {
        path: drawn.model_copy(update={"lognormal": DOUBT * drawn.lognormal})
        for path, drawn in plan.uncertain.items()
        if path.startswith(own) and drawn.lognormal and not (path.startswith("modes.") and path.endswith("damping"))
    }
    wider |= {
        path: drawn.model_copy(update={"lognormal": CONTACT_DOUBT * drawn.lognormal})
        for path, drawn in plan.uncertain.items()
        if path.startswith("contact.") and drawn.lognormal
    }
    asked, usual = (
        {path: drawn for path, drawn in spread.items() if ripple_order(path) is not None}
        for spread in (plan.wide.uncertain or {}, default_wide(machine))
    )
    ripple = asked or usual
    return {**plan.uncertain, **wider, **ripple}


def changed(
    entry: Entry, machine: Machine, recipe: Recipe, clearances: tuple[float, ...], parameters: Mapping[str, float]
) -> Entry:
    """Return a case with other clearances [m] and numbers [SI], of a machine."""
    return Entry.of(
        machine,
        recipe,
        hypothesis=entry.hypothesis,
        joints=entry.joints,
        clearances=clearances,
        parameters=parameters,
        draw=entry.draw,
        variant=entry.variant,
    )


def simulate_cases(
    catalogue: Catalogue, machine: Machine, cases: Sequence[Entry], progress: Callable[[int], None] | None = None
) -> FoundSpectra:
    """Simulate cases, on all processors, and return them in their order, without those that could not be.

    Parameters
    ----------
    catalogue : Catalogue
    machine : Machine
        Of the cases.
    cases : sequence of Entry
        One at least.
    progress : callable, optional
        Called with the number of cases done.
    """
    cuts = catalogue.matrix.cuts
    chunks = cut_chunks(machine, catalogue.recipe, cases, CHUNK)
    simulated: dict[str, FloatArray] = {}
    done = 0
    # Compiled code lets other threads run.
    with one_thread(), ThreadPoolExecutor(count_processors()) as threads:
        for chunk, outcomes in zip(chunks, threads.map(simulate_chunk, chunks), strict=True):
            for entry, outcome in zip(chunk.entries, outcomes, strict=True):
                if outcome.power is not None and outcome.cyclic is not None:
                    joined = np.add.reduceat(pack(outcome.power)[: cuts[-1]], cuts[:-1], axis=0)
                    simulated[entry.key] = np.concatenate([joined, pack_cyclic(outcome.cyclic)[: len(joined)]], axis=1)
            done += len(chunk.entries)
            if progress is not None:
                progress(done)
    entries = tuple(entry for entry in cases if entry.key in simulated)
    return FoundSpectra(catalogue.matrix, entries, np.array([simulated[entry.key] for entry in entries]))


def counting(progress: Callable[[int, int], None] | None, before: int, total: int) -> Callable[[int], None] | None:
    """Return what tells how many of all cases are done, called with those of a part before which some are already."""
    return None if progress is None else lambda done: progress(before + done, total)
