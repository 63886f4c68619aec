"""Dates and times as files write them: which of a file's texts is the moment of measurement, and what it says.

Nothing is guessed: 03/04/2026 may be in March or in April, so it is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from typing import TypeVar

_MONTHS = (
    ("jan", "ene", "gen"), ("feb", "fév", "fev"), ("mar", "mär", "maer", "mrz"), ("apr", "avr", "abr"),
    ("may", "mai", "mag"), ("jun", "juin", "giu"), ("jul", "juil", "lug"), ("aug", "août", "aou", "ago"),
    ("sep", "set"), ("oct", "okt", "ott"), ("nov",), ("dec", "dez", "déc", "dic"),
)  # fmt: skip
_MONTH_NUMBERS = {word: number for number, words in enumerate(_MONTHS, start=1) for word in words}
_MONTH = rf"(?P<name>{'|'.join(sorted(_MONTH_NUMBERS, key=len, reverse=True))})[^\W\d]*\.?"
_WEEKDAY = r"(?:(?:mon|tue|wed|thu|fri|sat|sun|mo|di|mi|do|fr|sa|so)[^\W\d]*[.,]*\s+)?"
_TIME = r"(?P<hour>\d{1,2}):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,](?P<part>\d+))?)?(?:\s*(?P<half>[ap])\.?m\b\.?)?"
_DATES = tuple(
    re.compile(_WEEKDAY + form, re.IGNORECASE)
    for form in (
        r"(?P<year>\d{4})([-/.])(?P<month>\d{1,2})\2(?P<day>\d{1,2})(?!\d)",
        r"(?P<first>\d{1,2})(?P<sign>[./-])(?P<other>\d{1,2})(?P=sign)(?P<year>\d{4}|\d\d)(?!\d)",
        rf"(?P<day>\d{{1,2}})[\s.-]+{_MONTH}[\s,-]+(?P<year>\d{{4}}|\d\d)(?!\d)",
        rf"{_MONTH}\s+(?P<day>\d{{1,2}}),?\s+{_TIME}\s+(?P<year>\d{{4}})(?!\d)",
        rf"{_MONTH}\s+(?P<day>\d{{1,2}}),?\s+(?P<year>\d{{4}})(?!\d)",
    )
)
_CLOCK = re.compile(_TIME, re.IGNORECASE)
_BETWEEN = re.compile(r"[\s,;|\"'@]*(?:T(?=\d)|(?:um|at|,)\s+)?", re.IGNORECASE)
_OTHER_TIME = re.compile(r"[\s_T,;|]*\d")
_ZONE = re.compile(r"\s*(?:(?P<offset>[+-]\d\d(?::?\d\d)?)|(?P<name>[A-Z]{1,5}))(?![\w:])")
#: Hours east of Greenwich; most other abbreviations mean several zones.
_ZONES = {"Z": 0, "UTC": 0, "GMT": 0, "CET": 1, "MEZ": 1, "CEST": 2, "MESZ": 2}
#: Seconds, or milliseconds, since 1970.
_EPOCH = re.compile(r"(\d{10}|\d{13})(?:\.(\d+))?")

#: What a text is called, letters alone, that says when a measurement began; and what any date may be called.
_BEGINS = re.compile(
    r"(measur(ed|ement)|record(ed|ing)?|acqui(red|sition)|start(ed)?|test|trigger|wfstart)(start)?"
    r"(at|on|date|time|datetime|timestamp)?|(date|time)of(measurement|recording|acquisition)"
    r"|(start|mess|aufnahme|trigger)(zeit|datum|zeitpunkt|beginn)|beginn|(gemessen|aufgenommen)(am|um)?"
    r"|datumder(messung|aufnahme)|messungvom|(date|heure)de(mesure|debut)|debut|(fecha|hora)de(inicio|medicion)"
    r"|(data|ora)inizio"
)
_NAMES = re.compile(
    r"(date|time|datetime|dateandtime|timestamp|datum|(datum(und)?)?(uhr)?zeit|zeitstempel|zeitpunkt"
    r"|fecha|(fechay?)?hora|heure|date(et)?heure|horodatage|data|(data)?ora|(datum)?tijd|tijdstip)"
)
_LINE = re.compile(rf"(?P<label>.*?)(?P<value>{_WEEKDAY}(?:{_MONTH}\s+)?\d.*)", re.IGNORECASE)


LOOKED_AT = 200
"""Characters of a line or a text; a date stands at its beginning."""

Place = TypeVar("Place")


@dataclass(frozen=True)
class RawMoment:
    """When a recording was made, as its file has it.

    Parameters
    ----------
    text : str
    where : str
        For messages: "line 3", "wf_start_time".
    """

    text: str
    where: str


def find_in_lines(lines: Sequence[tuple[int, str]]) -> tuple[RawMoment | None, set[int]]:
    """Return what lines above a table say, such as "Datum;21.11.2026 10:03", and which lines that is.

    Parameters
    ----------
    lines : sequence of (int, str)
        With their indices.
    """
    named = []
    for index, line in lines:
        found = _LINE.fullmatch(line.strip()[:LOOKED_AT])
        if found:
            named.append((index, found["label"], found["value"].replace('"', "")))
    moment, used = _choose(named)
    if moment is None:
        return None, set()
    return RawMoment(moment, " and ".join(f"line {index + 1}" for index in used)), set(used)


def find_in_members(members: Mapping[str, object]) -> tuple[RawMoment | None, set[str]]:
    """Return what named texts or numbers say, such as ``start_time``, and which of them; of a dotted name the last part
    counts.
    """
    named = [(name, name.rpartition(".")[2], _plain(value)) for name, value in members.items()]
    moment, used = _choose(named)
    return (None, set()) if moment is None else (RawMoment(moment, " and ".join(used)), set(used))


def _plain(value: object) -> str:
    return f"{value:.6f}" if isinstance(value, float) else str(value).strip()[:LOOKED_AT]


def _choose(named: Iterable[tuple[Place, str, str]]) -> tuple[str | None, list[Place]]:
    """Text of the moment and where it stands: the beginning of a measurement before any other date, the first of each.

    A date without a time of day takes that of a text that has nothing else.
    """
    dates: list[tuple[bool, Place, str]] = []
    times: list[tuple[bool, Place, str]] = []
    for place, label, value in named:
        letters = _letters(label)
        of_zone = letters.endswith(("utc", "gmt")) and letters not in ("utc", "gmt")
        letters = letters[:-3] if of_zone else letters
        begins = _BEGINS.fullmatch(letters) is not None
        if not begins and _NAMES.fullmatch(letters) is None:
            continue
        text = f"{value} UTC" if of_zone and not _EPOCH.fullmatch(value) else value
        if _match_date(value) or _EPOCH.fullmatch(value):
            dates.append((not begins, place, text))
        elif _CLOCK.match(value):
            times.append((not begins, place, text))
    if not dates:
        return None, []
    _, place, text = min(dates, key=lambda each: each[0])
    if times and not _EPOCH.fullmatch(text) and _time_of(text) is None:
        date = _match_date(text)
        assert date is not None
        _, at, clock = min(times, key=lambda each: each[0])
        zone = text[date.end() :].strip() if _ZONE.fullmatch(text, date.end()) else ""
        return f"{date[0]} {clock}{f' {zone}' if zone and clock[-1].isdigit() else ''}", [place, at]
    return text, [place]


def _letters(label: str) -> str:
    plain = label.lower().translate(str.maketrans("éèó", "eeo"))
    return "".join(each for each in plain if each.isalpha())


def _match_date(text: str) -> re.Match[str] | None:
    return next((found for form in _DATES if (found := form.match(text))), None)


def _time_of(text: str) -> tuple[re.Match[str], int] | None:
    """Time of the day in a text that begins with a date, and where what follows begins."""
    date = _match_date(text)
    assert date is not None
    if "hour" in date.groupdict():
        return date, date.end()
    clock = _CLOCK.match(text, _BETWEEN.match(text, date.end()).end())  # type: ignore[union-attr]
    return None if clock is None else (clock, clock.end())


def read_moment(text: str) -> tuple[datetime, bool]:
    """Return the moment that a text begins with, and whether it has a time of day.

    Parameters
    ----------
    text : str
        A date in figures or with the name of its month, a time, a zone; or seconds or milliseconds since 1970.

    Returns
    -------
    datetime
        Without a zone where the text has none.
    bool

    Raises
    ------
    ValueError
        It may be read in two ways, or in none; with the rule.
    """
    plain = text.strip()
    if number := _EPOCH.fullmatch(plain):
        seconds = float(plain) / (1000.0 if len(number[1]) == 13 else 1.0)
        return datetime.fromtimestamp(seconds, UTC), True
    date = _match_date(plain)
    if date is None:
        raise ValueError("is no date")
    year, month, day = _calendar(date)
    found = _time_of(plain)
    if found is None:
        if _OTHER_TIME.match(plain, date.end()):
            raise ValueError("has a time of a form that is not known")
        return _whole(year, month, day), False
    clock, end = found
    moment = _whole(year, month, day) + _since_midnight(clock)
    zone = _ZONE.match(plain, end)
    if zone is None:
        return moment, True
    if zone["offset"]:
        digits = zone["offset"].replace(":", "")
        east = timedelta(hours=int(digits[1:3]), minutes=int(digits[3:] or 0))
        if east > timedelta(hours=14) or east % timedelta(minutes=15):
            raise ValueError("has no such time zone")
        return moment.replace(tzinfo=timezone(-east if digits[0] == "-" else east)), True
    if zone["name"] not in _ZONES:
        raise ValueError(f"names a time zone {zone['name']}, which is not known")
    return moment.replace(tzinfo=timezone(timedelta(hours=_ZONES[zone["name"]]))), True


def _calendar(date: re.Match[str]) -> tuple[int, int, int]:
    parts = date.groupdict()
    if len(parts["year"]) == 2:
        raise ValueError("has a year of two digits")
    year = int(parts["year"])
    if "sign" in parts:
        first, other = int(parts["first"]), int(parts["other"])
        if parts["sign"] == "." or first > 12:
            return year, other, first
        if other <= 12 and first != other:
            raise ValueError("may begin with the day or with the month")
        return year, first, other
    month = _MONTH_NUMBERS[parts["name"].lower()] if parts.get("name") else int(parts["month"])
    return year, month, int(parts["day"])


def _whole(year: int, month: int, day: int) -> datetime:
    try:
        return datetime(year, month, day)
    except ValueError:
        raise ValueError("is no day of the calendar") from None


def _since_midnight(clock: re.Match[str]) -> timedelta:
    hour, minute, second = int(clock["hour"]), int(clock["minute"]), int(clock["second"] or 0)
    if clock["half"]:
        if not 1 <= hour <= 12:
            raise ValueError("is no time of the day")
        hour = hour % 12 + (12 if clock["half"].lower() == "p" else 0)
    if hour > 23 or minute > 59 or second > 59:
        raise ValueError("is no time of the day")
    return timedelta(hours=hour, minutes=minute, seconds=second, microseconds=int(f"{clock['part'] or 0:0<6}"[:6]))
