"""How a text file writes its table: delimiter, decimal sign, where the numbers begin."""

from __future__ import annotations

import contextlib
import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
#: Not numbers to compute with, but a cell of a table of numbers all the same.
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity|1\.#\w+)", re.IGNORECASE)
#: Of a cell that a program had no number for; not of a damaged one.
MISSING = r"-?nan|#?n/?a|#n/?v|#(num|div/0|value)!|null|none|-{1,3}|\?|invalid|missing|1\.#(ind|qnan|snan)"
_MISSING = re.compile(MISSING, re.IGNORECASE)
#: Of a cell whose number was too large to be measured: what a blow does, and nothing beside it says by how much.
_OVERLOAD = re.compile(r"[+-]?(over ?(flow|load|range|run)?|under ?(flow|range)|ovr|ovl|ol)", re.IGNORECASE)
#: Lines of words that may follow a table.
FOOTER = 50
_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}

#: Lines that must read as numbers, one after the other, before a table is believed to begin; and where some of their
#: columns hold text.
_CONVINCING, _CONVINCING_WITH_TEXT = 3, 10


@dataclass(frozen=True)
class Dialect:
    """Delimiter (a blank stands for any run of blanks) and decimal sign."""

    delimiter: str
    decimal: str

    @property
    def words(self) -> str:
        """For a report: "columns divided by semicolons, decimal comma"."""
        decimal = "comma" if self.decimal == "," else "point"
        return f"columns divided by {_NAMES[self.delimiter]}, decimal {decimal}"

    def split(self, line: str) -> list[str]:
        """Fields of a line, stripped, quotes taken off; empty fields at the end (trailing delimiters) are dropped."""
        if self.delimiter == " ":
            return line.split()
        text = line.strip("\r\n")
        raw = text.split(self.delimiter)
        if '"' in text:
            # A field of more than 128 KiB is an error: no table, whatever the quotes mean.
            with contextlib.suppress(csv.Error):
                raw = next(csv.reader([text], delimiter=self.delimiter), [""])
        fields = [field.strip() for field in raw]
        while len(fields) > 1 and not fields[-1]:
            fields.pop()
        return fields

    def split_row(self, line: str, columns: int) -> list[str]:
        """Fields of a row; the last ones are empty where the line has delimiters for them."""
        fields = self.split(line)
        if len(fields) < columns and self.delimiter != " ":
            fields += [""] * (min(line.count(self.delimiter) + 1, columns) - len(fields))
        return fields

    def rules_out(self, line: str) -> bool:
        """Whether a line is surely no row of numbers, at a glance: most lines are none in most dialects.

        A field that may stand in a table holds one decimal sign at most, and a comma only where that is it.
        """
        if self.decimal == ".":
            return self.delimiter != "," and "," in line
        fields = len(line.split()) if self.delimiter == " " else line.count(self.delimiter) + 1
        return line.count(".") + line.count(",") > fields

    def number(self, field: str) -> float | None:
        """Value of a field, or None when it is not a finite number."""
        plain = field.replace(",", ".") if self.decimal == "," else field
        return float(plain) if _NUMBER.fullmatch(plain) else None

    def is_cell(self, field: str) -> bool:
        """Whether a field may stand in a table of numbers: a number, or a NaN or infinity (refused later by name)."""
        return self.number(field) is not None or _NOT_FINITE.fullmatch(field) is not None

    @staticmethod
    def is_missing(field: str) -> bool:
        """Whether a field of a row has no number, and says so: it is empty, "NaN" or "Overflow"."""
        return not field or _MISSING.fullmatch(field) is not None

    def rule_of(self, field: str) -> str:
        """Return the rule that a cell without a number breaks."""
        if not field:
            return "is empty"
        if _OVERLOAD.fullmatch(field):
            return "is beyond the range that was measured: measure again in a wider one"
        return "is not finite" if self.is_cell(field) else "is not a number: correct it"


DIALECTS = tuple(Dialect(delimiter, decimal) for delimiter in ";\t|, " for decimal in ".," if delimiter != decimal)


@dataclass(frozen=True)
class TableLayout:
    """Where a table stands in a file.

    Parameters
    ----------
    dialect : Dialect
    first : int
        Index of the first line of numbers.
    columns : int
        Fields a line.
    surplus : int
        Empty fields at the end of the first line.
    texts : frozenset of int
        Places of the fields, from 0, that are no numbers.
    """

    dialect: Dialect
    first: int
    columns: int
    surplus: int = 0
    texts: frozenset[int] = frozenset()


def dialects_of(delimiter: str | None, decimal: str | None) -> tuple[Dialect, ...]:
    """Dialects with this delimiter and this decimal sign, where they are known."""
    return tuple(
        dialect for dialect in DIALECTS if delimiter in (None, dialect.delimiter) and decimal in (None, dialect.decimal)
    )


def find_layout(
    lines: Sequence[str],
    dialects: Sequence[Dialect] = DIALECTS,
    skipped: int = 0,
    is_ignored: Callable[[str], bool] = lambda label: False,
) -> TableLayout | None:
    """Dialect and beginning of the table in the first lines of a file.

    Parameters
    ----------
    lines : sequence of str
        The first few hundred lines are enough.
    dialects : sequence of Dialect
        That come into question.
    skipped : int
        First lines that no table begins in.
    is_ignored : callable
        Whether the column below a label may hold whatever it likes.

    Returns
    -------
    TableLayout or None
        The dialect that makes some lines in a row a table of numbers, by preference one whose fields are as many in the
        line above (the header), then the one with most columns of numbers. Where no dialect does, some columns may
        hold text; None when that does not help.
    """
    candidates = [
        (index, line)
        for index, line in enumerate(lines[skipped:], start=skipped)
        if line.strip() and not is_comment(line)
    ]
    for with_text in (False, True):
        best: tuple[tuple[bool, int, int], TableLayout] | None = None
        for preference, dialect in enumerate(dialects):
            texts = _texts_in(candidates, dialect, is_ignored) if with_text else frozenset[int]()
            layout = _table_of(candidates, dialect, texts)
            if layout is None:
                continue
            header = header_line(lines, layout)
            rank = (header is not None, layout.columns - len(layout.texts), -preference)
            if best is None or rank > best[0]:
                best = (rank, layout)
        if best is not None:
            return _from_first_row(best[1], candidates)
    return None


def _from_first_row(layout: TableLayout, lines: Sequence[tuple[int, str]]) -> TableLayout:
    """Return a layout that begins with the rows above it that have a number in most of their cells, and no text."""
    first, dialect = layout.first, layout.dialect
    for index, line in reversed([each for each in lines if each[0] < layout.first]):
        fields = dialect.split_row(line, layout.columns)
        kept = [field for place, field in enumerate(fields) if place not in layout.texts]
        numbers = sum(map(dialect.is_cell, kept))
        if len(fields) != layout.columns or 2 * numbers < len(kept) or len(kept) < 2:
            break
        if not all(dialect.is_cell(field) or dialect.is_missing(field) for field in kept):
            break
        first = index
    return replace(layout, first=first)


def _texts_in(lines: Sequence[tuple[int, str]], dialect: Dialect, is_ignored: Callable[[str], bool]) -> frozenset[int]:
    """Places of the columns that hold no numbers: those that are ignored, and those of text in many lines in a row."""
    ignored: frozenset[int] = frozenset()
    last: tuple[int, frozenset[int]] = (0, frozenset())
    found, longest = 0, (_CONVINCING_WITH_TEXT - 1, ignored)
    for _, line in lines:
        fields = dialect.split(line)
        ignored = frozenset(place for place, field in enumerate(fields) if is_ignored(field)) or ignored
        texts = frozenset(place for place, field in enumerate(fields) if not dialect.is_cell(field)) | ignored
        found = found + 1 if (len(fields), texts) == last else 1
        last = (len(fields), texts)
        if found > longest[0] and len(texts) < len(fields):
            longest = (found, texts)
    return longest[1] or ignored


def header_line(lines: Sequence[str], layout: TableLayout) -> int | None:
    """Index of the line right above the table (blank lines aside), if it has as many fields as the table."""
    for index in range(layout.first - 1, -1, -1):
        if lines[index].strip():
            return index if len(header_fields(lines[index], layout)) == layout.columns else None
    return None


def header_fields(line: str, layout: TableLayout) -> list[str]:
    """Fields of a header line; a comment sign before them does not count.

    Between blanks, "time [s]" is two words: there, labels are told apart by two blanks, a tab or a closing bracket.
    """
    text = line.strip().lstrip("#%/").strip() if is_comment(line) else line.strip()
    fields = layout.dialect.split(text)
    if layout.dialect.delimiter == " " and len(fields) != layout.columns:
        fields = [part.strip() for part in re.split(r"\s{2,}|\t|(?<=[\])])\s+", text) if part.strip()]
    return fields


def is_comment(line: str) -> bool:
    """Whether a line is a comment: it begins with #, % or //."""
    return line.lstrip().startswith(("#", "%", "//"))


def _table_of(lines: Sequence[tuple[int, str]], dialect: Dialect, texts: frozenset[int]) -> TableLayout | None:
    """Return the first table in numbered lines that are neither blank nor a comment."""
    first, columns, found = 0, 0, 0
    for index, line in lines:
        if not texts and dialect.rules_out(line):
            found = 0
            continue
        fields = dialect.split(line)
        if all(place in texts or dialect.is_cell(field) for place, field in enumerate(fields)):
            if found and len(fields) == columns:
                found += 1
            else:
                first, columns, found = index, len(fields), 1
            if found == _CONVINCING and any(place not in texts for place in range(columns)):
                plain = dict(lines)[first].rstrip("\r\n ")
                ends = len(plain) - len(plain.rstrip(dialect.delimiter)) if dialect.delimiter != " " else 0
                return TableLayout(dialect, first, columns, ends, texts)
        else:
            found = 0
    return None
