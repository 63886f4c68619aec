"""How well a number tells what a catalogue does not hold from what it does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import rankdata


def auroc(positive: Sequence[float], negative: Sequence[float]) -> float | None:
    """Return the probability that a positive scores higher than a negative, ties counting one half; None without any.

    Area under the receiver operating characteristic, by ranks (Hanley and McNeil, Radiology 143 (1982) 29).
    """
    if not len(positive) or not len(negative):
        return None
    ranks = rankdata(np.concatenate([positive, negative]))
    n = len(positive)
    return float((ranks[:n].sum() - 0.5 * n * (n + 1)) / (n * len(negative)))


def rejected(foreign: Sequence[float], listed: Sequence[float], false_alarms: float = 0.05) -> float | None:
    """Return the share of p-values below the highest limit that at most the share `false_alarms` of `listed` is below.

    None without any. Values that are tied at the limit are not below it.
    """
    if not len(foreign) or not len(listed):
        return None
    limit = np.sort(listed)[int(false_alarms * len(listed) + 1e-9)]
    return float(np.mean(np.asarray(foreign) < limit))
