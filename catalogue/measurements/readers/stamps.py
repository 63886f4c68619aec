"""Columns of dates with times in tables of text, "2026-11-21T10:00:00.000100", as seconds since the first of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.measurements.readers.dialect import is_comment

#: With a decimal comma only where none can divide columns.
_STAMP = re.compile(
    r"(?<![^\s;,|])(?P<quote>\"?)(?:(?P<date>\d{4}[-/]\d\d[-/]\d\d)|(?P<day>\d\d)\.(?P<month>\d\d)\.(?P<year>\d{4}))"
    r"[T ](?P<time>\d\d:\d\d:\d\d)(?:\.(?P<part>\d{1,9})\d*|,(?P<other>\d{1,9})(?=[;\t|\"]))?"
    r"\s?(?P<zone>Z|UTC|[+-]\d\d:?\d\d)?(?P=quote)(?=[\s;,|]|$)"
)
_CONVINCING = 3


@dataclass(frozen=True)
class Stamps:
    """A table without its dates.

    Parameters
    ----------
    text : str
        With seconds in their place.
    first : str
        The first of them.
    before : str
        What stands before it in its line.
    """

    text: str
    first: str
    before: str


def replace_stamps(text: str, head: Sequence[str]) -> Stamps | None:
    """Return a table with seconds since the first row in place of dates; None where its lines have none.

    Parameters
    ----------
    text : str
    head : sequence of str
        Its first lines: all from some line on have a date.
    """
    begin = len(head)
    count = 0
    for index in range(len(head) - 1, -1, -1):
        if not head[index].strip() or is_comment(head[index]):
            continue
        if _STAMP.search(head[index]) is None:
            break
        begin, count = index, count + 1
    if count < _CONVINCING:
        return None
    lines = text.split("\n")
    found = [_STAMP.search(line) for line in lines[begin:]]
    stamps = [each for each in found if each is not None]
    try:
        moments = np.array([_plain(each) for each in stamps], dtype="datetime64[ns]")
    except ValueError:  # no day of the calendar
        return None
    digits = max(len(each["part"] or each["other"] or "") for each in stamps)
    seconds = iter((moments - moments[0]).astype(np.int64) / 1e9)
    lines[begin:] = [
        line if each is None else f"{line[: each.start()]}{next(seconds):.{digits}f}{line[each.end() :]}"
        for line, each in zip(lines[begin:], found, strict=True)
    ]
    first = stamps[0]
    return Stamps("\n".join(lines), f"{_plain(first)}{first['zone'] or ''}", first.string[: first.start()])


def _plain(stamp: re.Match[str]) -> str:
    date = stamp["date"] or f"{stamp['year']}-{stamp['month']}-{stamp['day']}"
    return f"{date.replace('/', '-')}T{stamp['time']}.{stamp['part'] or stamp['other'] or '0'}"
