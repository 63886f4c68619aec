"""Contact laws by name, the hysteresis each makes of a coefficient of restitution, and the one it really returns.

For F = K d^n (1 + c d'/v0), v0 the velocity of approach when the contact begins, a free impact obeys
c - ln(1 + c) = -c e - ln(1 - c e), whatever K, n, v0 and the masses: separate d in m v dv = -F dd. The laws differ in
the c they make of the restitution they are asked for, each from an energy balance of its own.

References: Hunt and Crossley 1975 (J. Appl. Mech. 42, 440); Lankarani and Nikravesh 1990 (J. Mech. Des. 112, 369);
Gonthier, McPhee, Lange and Piedboeuf 2004 (Multibody Syst. Dyn. 11, 209); Flores, Machado, Silva and Martins 2011
(Multibody Syst. Dyn. 25, 357).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from importlib.metadata import EntryPoint
from typing import Any, TypeVar

from jointplay.solver.extensions import entry_points_of

_Number = TypeVar("_Number")


def _load_law(law: EntryPoint, e: Any) -> Any:
    return law.load()(e)


#: c of each law that takes a restitution e; of numbers and of symbols.
_OWN: Mapping[str, Callable[[Any], Any]] = {
    "hunt-crossley": lambda e: 1.5 * (1 - e),
    "flores": lambda e: 1.6 * (1 - e) / e,
    "gonthier": lambda e: (1 - e * e) / e,
    "lankarani-nikravesh": lambda e: 0.75 * (1 - e * e),
}
_KNOWN = ("linear", "hertz", *_OWN)
_OTHER = {name: partial(_load_law, law) for name, law in entry_points_of("contact_laws").items() if name not in _KNOWN}
HYSTERESIS: Mapping[str, Callable[[Any], Any]] = {**_OWN, **_OTHER}
CONTACT_LAWS = ("linear", "hertz", *HYSTERESIS)
#: A law that misses what it was asked for by more than this part says so.
WORTH_SAYING = 0.05


def hysteresis_factor(law: str, e: _Number) -> _Number:
    """The factor c that a law of :data:`HYSTERESIS` makes of a restitution, a number or a symbol."""
    factor: _Number = HYSTERESIS[law](e)
    return factor


def restitution_of(c: float) -> float:
    """Restitution of a free impact with hysteresis factor c >= 0."""

    def identity(e: float) -> float:
        return math.log1p(-c * e) + c * e + c - math.log1p(c)

    if c < 1e-6:
        return 1.0 - 2.0 / 3.0 * c  # the identity to first order; its terms cancel here
    # The left side falls from c - ln(1 + c) > 0 at e = 0 to minus infinity at e = 1/c.
    highest = min(1.0, (1 - 1e-15) / c)
    if identity(highest) > 0:  # c so large that e is 1/c to the last bit
        return highest
    from scipy.optimize import brentq  # takes some time to load; few machines need it

    return float(brentq(identity, 0.0, highest, xtol=1e-16, rtol=1e-14))


def effective_restitution(law: str, e: float) -> float:
    """Restitution that a contact law returns in a free impact when it is asked for `e`.

    Parameters
    ----------
    law : str
        A law of :data:`HYSTERESIS`, or ``linear`` with the damping ratio -ln e / sqrt(pi^2 + ln^2 e) that would give
        `e` if the contact pulled until the penetration is gone.
    e : float
        0 < e <= 1.

    Notes
    -----
    The linear pair never pulls: it parts where K d + C d' = 0, earlier and with more of its velocity, e =
    exp(-zeta / sqrt(1 - zeta^2) (pi - 2 asin zeta)).
    """
    if law == "linear":
        ratio = -math.log(e) / math.hypot(math.pi, math.log(e))
        return math.exp(-ratio / math.sqrt(1 - ratio * ratio) * (math.pi - 2 * math.asin(ratio)))
    return restitution_of(hysteresis_factor(law, e))


def remark(law: str, e: float) -> str:
    """One line where a law returns another restitution than `e` by more than 5 %; empty where it does not."""
    found = effective_restitution(law, e)
    if abs(found - e) <= WORTH_SAYING * e:
        return ""
    return f"contact law {law} asked for a restitution of {e:.3g} returns {found:.3g}"
