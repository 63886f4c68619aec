"""Where what is answered differs from its example: ids, times and the last digits of what was computed aside."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

ID = re.compile(r"\b[0-9a-f]{12,64}\b")
SECRET = re.compile(r"whsec_[\w+/=]+|jp_[0-9a-f]{12}_[\w-]+")
TIME = re.compile(r"\d{4}-\d\d-\d\dT[\d:.]+Z")
NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")
#: Numbers that were computed differ from one computer to another: joints that knock make much of a rounding, and the
#: catalogue of these examples is small.
RELATIVE, ABSOLUTE = 0.5, 0.1
#: The ends of intervals more so: 4.0 and 8.4 um were the lower end of what was hardly heard, with AVX2 and AVX-512.
ENDS, RELATIVE_ENDS = frozenset({"low_um", "interval_um"}), 0.7
#: Told where something of it can be heard at all; near that, there or not.
AT_THE_EDGE = "detectable_from_um"
#: Bytes of a text of computed numbers, whose last digits may be noughts that are not written.
SIZE, RELATIVE_SIZE = "size_bytes", 1e-3
#: Hypotheses that are less likely are what rounding makes of them: their order and their numbers are no difference, nor
#: is what evidence says against the likeliest of them, the rival.
NEGLIGIBLE, RIVAL = 0.01, "rival"
#: What a forecast of a build measures.
MEASURED = frozenset({"seconds", "tried", "size_bytes"})
#: Made when somebody asks for it, once a catalogue, which tests share: there or not, whoever came first.
MADE_ON_REQUEST = "quality"
#: How a text ends that was cut, and how much of its end may be half a word.
CUT, LAST_WORD = "…", 20


def differences(one: Any, other: Any, place: str) -> Iterator[str]:
    """Where two answers differ, one line each."""
    if isinstance(one, dict) and isinstance(other, dict):
        if one.get(RIVAL) != other.get(RIVAL):
            one, other = dict.fromkeys(one), dict.fromkeys(other)
        for name in one.keys() | other.keys():
            if name in one and name in other:
                if name in MEASURED and "/forecasts" in place:
                    continue
                if name in (MADE_ON_REQUEST, AT_THE_EDGE) and None in (one[name], other[name]):
                    continue
                if name == SIZE and math.isclose(one[name], other[name], rel_tol=RELATIVE_SIZE):
                    continue
                yield from differences(one[name], other[name], f"{place}/{name}")
            else:
                yield f"{place}/{name} is only {'written' if name in one else 'answered'}"
    elif isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            yield f"{place} has {len(one)} items, not {len(other)}"
        one, other = ranking(one), ranking(other)
        for number, (each, its) in enumerate(zip(one, other, strict=False)):
            yield from differences(each, its, f"{place}/{number}")
    elif isinstance(one, float) and isinstance(other, float):
        relative = RELATIVE_ENDS if ENDS & set(place.split("/")) else RELATIVE
        if not math.isclose(one, other, rel_tol=relative, abs_tol=ABSOLUTE):
            yield f"{place} is {one}, not {other}"
    elif isinstance(one, str) and isinstance(other, str):
        first, second = plain(one), plain(other)
        if one.endswith(CUT) and other.endswith(CUT):  # where exactly depends on the length of its numbers
            most = min(len(first), len(second)) - LAST_WORD
            first, second = first[:most], second[:most]
        if first != second:
            yield f"{place} is {one!r}, not {other!r}"
    elif type(one) is not type(other) or one != other:
        yield f"{place} is {one!r}, not {other!r}"


def ranking(items: list[Any]) -> list[Any]:
    """Hypotheses with what is left of those that are not negligible, these by name; any other list as it is."""
    if not all(isinstance(each, dict) and {"label", "probability"} <= each.keys() for each in items):
        return items
    likely = [each for each in items if each["probability"] >= NEGLIGIBLE]
    return likely + sorted(each["label"] for each in items if each["probability"] < NEGLIGIBLE)


def plain(text: str) -> str:
    """A text without what differs from call to call."""
    return NUMBER.sub("0", ID.sub("ID", TIME.sub("TIME", SECRET.sub("SECRET", text))))
