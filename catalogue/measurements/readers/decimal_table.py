"""Plain tables of decimal numbers, read by compiled code; whatever is not plain is left to a reader that knows more."""

from __future__ import annotations

from typing import Any

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.compiler.native import compiled

BLANK, NEWLINE, PLUS, MINUS, POINT, ZERO, NINE, SMALL_E, LARGE_E = (ord(mark) for mark in " \n+-.09eE")
#: Whole numbers up to 2^53 and powers of ten up to 10^22 are doubles, so that one operation with both is rounded once:
#: the result is the double that is nearest to the decimal (Clinger 1990), as any correct reader gives it.
EXACT = 2**53
POWERS = 10.0 ** np.arange(23)


def _fill(text: Any, delimiter: int, powers: Any, table: Any) -> int:
    """Fill a table from its text; return the number of rows, or -1 for anything that is not plain.

    Parameters
    ----------
    text : (n,) array of uint8
        Ends with a newline.
    delimiter : int
        Between fields; blanks around a field do not count.
    powers : (23,) array
        Powers of ten.
    table : (rows, columns) array
        To be filled.
    """
    rows, columns = table.shape
    end = len(text)
    at = 0
    row = 0
    while at < end:
        if row == rows:
            return -1
        for column in range(columns):
            while text[at] == BLANK:
                at += 1
            negative = text[at] == MINUS
            if negative or text[at] == PLUS:
                at += 1
            mantissa = 0
            digits = 0
            places = 0
            pointed = False
            while True:
                mark = text[at]
                if ZERO <= mark <= NINE:
                    mantissa = 10 * mantissa + (mark - ZERO)
                    digits += 1
                    places += 1 if pointed else 0
                    if mantissa > EXACT:
                        return -1
                elif mark == POINT and not pointed:
                    pointed = True
                else:
                    break
                at += 1
            if digits == 0:
                return -1
            exponent = -places
            if text[at] == SMALL_E or text[at] == LARGE_E:
                at += 1
                down = text[at] == MINUS
                if down or text[at] == PLUS:
                    at += 1
                size = 0
                first = at
                while ZERO <= text[at] <= NINE and at - first < 4:
                    size = 10 * size + (text[at] - ZERO)
                    at += 1
                if at == first:
                    return -1
                exponent += -size if down else size
            value = float(mantissa)
            if exponent < -22 or exponent > 22:
                return -1
            value = value / powers[-exponent] if exponent < 0 else value * powers[exponent]
            table[row, column] = -value if negative else value
            while text[at] == BLANK:
                at += 1
            if text[at] != (delimiter if column < columns - 1 else NEWLINE):
                return -1
            at += 1
        row += 1
    return row


_filled = compiled(_fill)


def plain_table(text: str, delimiter: str, columns: int) -> FloatArray | None:
    """Return the numbers of a table whose rows all have the same form; ``None`` where there is more to it.

    Parameters
    ----------
    text : str
        Lines that end with a newline; decimal points.
    delimiter : str
        One character, no blank.
    columns : int
        Fields in a row.

    Returns
    -------
    (rows, columns) array or None
        The doubles that are nearest to the decimals. ``None`` for blank lines, comments, quotes, missing or additional
        fields, what is no finite number, and numbers of so many digits that they need care.
    """
    if not text.isascii():
        return None
    content = np.frombuffer((text if text.endswith("\n") else text + "\n").encode("ascii"), np.uint8)
    table = np.empty((np.count_nonzero(content == NEWLINE), columns))
    rows = _filled(content, ord(delimiter), POWERS, table)
    return table if rows == len(table) else None
