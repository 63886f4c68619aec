"""Which mount of a machine has come loose since it was in order, by simulations of that machine with and without."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from jointplay.catalogue.diagnosing.cause_families import SMALL_STIFFNESS, mounts_of
from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.drawn_mounts import find_loose
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.diagnosing.told_numbers import regress
from jointplay.catalogue.matching.learning import Learning, training_set
from jointplay.catalogue.matching.model_library import Observed, one_thread
from jointplay.solver.machines.machine import Machine

LOOSE_BELOW = 1.0 / SMALL_STIFFNESS
"""Factor on stiffness: what is above is a small change, here as in the search for causes."""

FIRST = 192
"""Cases of a set that are asked, the first draws, which fill its range evenly: the time grows with their cube."""


def name_loose_mount(
    machine: Machine, spectra: FoundSpectra, observed: Observed, labels: Sequence[str]
) -> NamedCause | None:
    """Return the mount that has come loose in a recording, as the cases of the likely sets of joints show it.

    Parameters
    ----------
    machine : Machine
    spectra : FoundSpectra
        In some of whose machines a mount is loose.
    observed : Observed
    labels : sequence of str
        Of the sets whose cases are asked.

    Returns
    -------
    NamedCause or None
        None where no mount is likely to be looser than in small changes; the likeliest where several are.
    """
    rows = {label: spectra.rows(label)[:FIRST] for label in labels}
    mounts = mounts_of(machine)
    if not mounts:
        return None
    with one_thread():
        sets = training_set(spectra, observed.sensing, observed.watched, Learning(rows=1), rows=rows).hypotheses
        features = np.concatenate([each.features for each in sets])
        numbers = np.zeros((len(features), len(mounts)))
        for row, case in enumerate(np.concatenate([rows[each.label] for each in sets]).tolist()):
            entry = spectra.entries[case]
            place, factor = find_loose(machine, entry.hypothesis.label, entry.draw)
            if place >= 0:
                numbers[row, mounts.index(place)] = math.log(factor)
        mean, error, _ = regress(features, numbers, observed.feature)
    likely = ndtr((math.log(LOOSE_BELOW) - mean) / error)
    which = int(np.argmax(likely))
    if likely[which] < 0.5:
        return None
    size = float(np.exp(mean[which]))
    return NamedCause(f"mount {mounts[which]}", size, "x stiffness", float(likely[which]), since=True)
