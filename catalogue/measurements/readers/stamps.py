"""Times in tables of text, "2026-11-21T10:00:00.0001", "14:05:06.0002", "2:05:06 PM", as seconds since the first.

The date may stand before the time or in a column before it, or there may be none; then a day passes at midnight.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import pairwise

from jointplay.catalogue.measurements.readers.dialect import FOOTER, is_comment

#: With a decimal comma only where none can divide columns.
_STAMP = re.compile(
    r"(?<![^\s;,|])(?P<quote>\"?)"
    r"(?:(?P<date>\d{4}[-/]\d\d[-/]\d\d|\d{1,2}\.\d{1,2}\.(?:\d{4}|\d\d)|\d{1,2}/\d{1,2}/(?:\d{4}|\d\d))"
    r"(?:[T ]|(?P<apart>(?P=quote)[ ]?[;,\t|][ ]?(?P=quote))))?"
    r"(?P<time>(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d))"
    r"(?:\.(?P<part>\d{1,9})\d*|,(?P<other>\d{1,9})(?=[;\t|\"]))?"
    r"(?:\s?(?P<half>[AP])\.?M\b\.?)?\s?(?P<zone>(?-i:Z|UTC)|[+-]\d\d:?\d\d)?(?P=quote)(?=[\s;,|]|$)",
    re.IGNORECASE,
)
_CONVINCING = 3
_SECOND, _DAY = 10**9, 86_400 * 10**9


@dataclass(frozen=True)
class Stamps:
    """A table with seconds in place of its times.

    Parameters
    ----------
    text : str
    first : str
        The first of the times, with its date where it has one.
    before : str
        What stands before it in its line.
    dated : bool
        Whether there are dates.
    """

    text: str
    first: str
    before: str
    dated: bool


def replace_stamps(text: str, head: Sequence[str]) -> Stamps | None:
    """Return a table with seconds since the first row in place of times; None where its lines have none.

    Parameters
    ----------
    text : str
    head : sequence of str
        Its first lines: all from some line on have a time, but for a few at their end.
    """
    begin = len(head)
    count = 0
    for index in range(len(head) - 1, -1, -1):
        if not head[index].strip() or is_comment(head[index]):
            continue
        if _STAMP.search(head[index]) is not None:
            begin, count = index, count + 1
        elif count or index < len(head) - FOOTER:
            break
    if count < _CONVINCING:
        return None
    lines = text.split("\n")
    found = [_STAMP.search(line) for line in lines[begin:]]
    stamps = [each for each in found if each is not None]
    try:
        moments = _nanoseconds(stamps)
    except ValueError:  # no day of the calendar, no time of a day
        return None
    digits = max(len(each["part"] or each["other"] or "") for each in stamps)
    seconds = ((moment - moments[0]) / 1e9 for moment in moments)
    lines[begin:] = [
        line if each is None else _put(each, line, f"{next(seconds):.{digits}f}")
        for line, each in zip(lines[begin:], found, strict=True)
    ]
    first = stamps[0]
    begins, _ = _span(first)
    return Stamps("\n".join(lines), _spelled(first), first.string[:begins], first["date"] is not None)


def _span(stamp: re.Match[str]) -> tuple[int, int]:
    """Where seconds go: a date in a column of its own stays there."""
    if stamp["apart"] is None:
        return stamp.span()
    return stamp.end("apart"), stamp.end() - len(stamp["quote"])


def _put(stamp: re.Match[str], line: str, seconds: str) -> str:
    begin, end = _span(stamp)
    return f"{line[:begin]}{seconds}{line[end:]}"


def _spelled(stamp: re.Match[str]) -> str:
    day = f"{stamp['date']} " if stamp["date"] else ""
    half = f" {stamp['half']}M" if stamp["half"] else ""
    return f"{day}{stamp['time']}.{stamp['part'] or stamp['other'] or '0'}{half}{stamp['zone'] or ''}"


def _nanoseconds(stamps: Sequence[re.Match[str]]) -> list[int]:
    """Times of rows, ascending over midnight.

    Raises
    ------
    ValueError
        For what is no date, or no time of a day.
    """
    clock = [_since_midnight(each) for each in stamps]
    if all(each["date"] for each in stamps):
        days = _days([each["date"] for each in stamps])
        return [day * _DAY + time for day, time in zip(days, clock, strict=True)]
    return list(_over_midnight(clock))


def _since_midnight(stamp: re.Match[str]) -> int:
    hour, minute, second = int(stamp["hour"]), int(stamp["minute"]), int(stamp["second"])
    if stamp["half"]:
        if not 1 <= hour <= 12:
            raise ValueError("is no time of the day")
        hour = hour % 12 + (12 if stamp["half"].upper() == "P" else 0)
    if hour > 23 or minute > 59 or second > 59:
        raise ValueError("is no time of the day")
    part = f"{stamp['part'] or stamp['other'] or '0':0<9}"
    return (3600 * hour + 60 * minute + second) * _SECOND + int(part)


def _over_midnight(clock: Sequence[int]) -> Iterator[int]:
    """Times of day where each that is half a day before the last is one of the next day."""
    day = 0
    yield clock[0]
    for before, after in pairwise(clock):
        day += _DAY if before - after > _DAY // 2 else 0
        yield after + day


def _days(dates: Sequence[str]) -> list[int]:
    """Numbers of the days of dates.

    Where day and month cannot be told apart, they are so that the dates lie close: only the differences count here.
    """
    known = {each: [int(part) for part in re.split(r"[-/.]", each)] for each in dict.fromkeys(dates)}
    ways = []
    for month in (0, 1):
        try:
            numbers = {each: _day(each, parts, month) for each, parts in known.items()}
        except ValueError:
            continue
        ways.append((max(numbers.values()) - min(numbers.values()), month, numbers))
    if not ways:
        raise ValueError("is no day of the calendar")
    numbers = min(ways)[2]
    return [numbers[each] for each in dates]


def _day(text: str, parts: Sequence[int], month: int) -> int:
    if len(re.split(r"\D", text)[0]) == 4:
        return date(*parts).toordinal()
    first, other, year = parts
    year += 2000 if year < 100 else 0
    if "." in text or month == 1:
        return date(year, other, first).toordinal()
    return date(year, first, other).toordinal()
