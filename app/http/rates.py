"""Rate limits: a bucket of tokens for every client."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable

KEPT = 10_000


class TokenBuckets:
    """One bucket a client, filled evenly, emptied by requests.

    Parameters
    ----------
    rate : float
        Tokens a second.
    burst : float
        Tokens that a full bucket holds.
    clock : callable
        Gives a time [s] that never goes back.
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = rate
        self._burst = burst
        self._clock = clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, client: str) -> float:
        """Take a token; return 0, or when the bucket is empty the time until there is one [s]."""
        present = self._clock()
        tokens, filled_at = self._buckets.pop(client, (self._burst, present))
        tokens = min(self._burst, tokens + (present - filled_at) * self._rate)
        wait = 0.0 if tokens >= 1 else (1 - tokens) / self._rate
        self._buckets[client] = (tokens if wait else tokens - 1, present)
        # A client that was forgotten begins with a full bucket: with 10 000 others in between it has waited long.
        if len(self._buckets) > KEPT:
            self._buckets.popitem(last=False)
        return wait

    def __len__(self) -> int:
        """Return the number of clients that are remembered."""
        return len(self._buckets)
