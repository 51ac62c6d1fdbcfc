"""Compiled reading of CSV cells: bytes to correctly rounded numbers, with every odd cell reported.

All compiled functions of the package are in this file, so that numba's cache on disk notices every
change in them. Plain decimal numbers are read here; whatever else a cell holds is left to
:mod:`cassini_bayes.events.telemetry.csv_file`, which knows how to say what is wrong with it.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.computing.compilation import compiled

NEWLINE: Final = 10
RETURN: Final = 13
BLANK: Final = 32
MOST_DIGITS: Final = 18  # so that they fit into 63 bits
MOST_TENS: Final = 40
NUMBERS: Final = 0
TEXT: Final = 1
UNREAD: Final = 2
"""What a column holds: numbers, text that another reader takes, or what nobody asked for."""
BAD_LENGTH: Final = -1
"""In place of a column of an odd cell: the line has another number of cells than the header."""


def powers_of_ten() -> Array:
    """10^k as the exact sum of two doubles (2, 41), k = 0 … 40."""
    whole = [10**k for k in range(MOST_TENS + 1)]
    high = [float(value) for value in whole]
    rest = [float(value - int(h)) for value, h in zip(whole, high, strict=True)]
    return np.array([high, rest])


@compiled
def _scaled(digits: np.int64, exponent: int, powers: Array) -> float:
    """digits · 10^exponent, rounded once: the error of the first rounding is added back.

    Products are split after Dekker, so the remainder is exact; two roundings can differ from one
    only when a value lies within some 1e-14 of a rounding step of the middle between two doubles.
    """
    high = float(digits)
    rest = float(digits - np.int64(high))
    if exponent == 0:
        return high
    power: float = powers[0, abs(exponent)]
    power_rest: float = powers[1, abs(exponent)]
    other = power if exponent > 0 else high / power
    left = power if exponent < 0 else high
    product = left * other
    a = 134217729.0 * left
    a_high = a - (a - left)
    b = 134217729.0 * other
    b_high = b - (b - other)
    a_low, b_low = left - a_high, other - b_high
    error = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    if exponent > 0:
        return product + (error + rest * power + high * power_rest)
    remainder = (high - product) - error + rest - other * power_rest
    return other + remainder / power


@compiled
def _is_digit(byte: np.uint8) -> bool:
    return bool(48 <= byte <= 57)


@compiled
def _digits(
    text: NDArray[np.uint8], place: int, digits: np.int64, used: int
) -> tuple[int, np.int64, int]:
    """Take up the digits from a place on: where they end, their number, how many count in it."""
    while _is_digit(text[place]) and used <= MOST_DIGITS:
        digits = digits * 10 + (np.int64(text[place]) - 48)
        used += digits != 0
        place += 1
    return place, digits, used


@compiled
def _number(text: NDArray[np.uint8], start: int, powers: Array) -> tuple[int, float]:
    """Read ``[+-]digits[.digits][e[+-]digits]``: the place behind it, or -1 if it is no such."""
    place = start
    negative = text[place] == 45
    if negative or text[place] == 43:
        place += 1
    exponent, first = 0, place
    place, digits, used = _digits(text, place, np.int64(0), 0)
    count = place - first
    if text[place] == 46:
        first = place + 1
        place, digits, used = _digits(text, first, digits, used)
        exponent = first - place
        count -= exponent
    if count == 0 or used > MOST_DIGITS:
        return -1, 0.0
    if text[place] == 101 or text[place] == 69:
        place += 1
        down = text[place] == 45
        if down or text[place] == 43:
            place += 1
        size: Any = np.int64(0)
        count = 0
        while _is_digit(text[place]) and count < 4:
            size = size * 10 + (np.int64(text[place]) - 48)
            count += 1
            place += 1
        if count == 0:
            return -1, 0.0
        exponent += -size if down else size
    if digits == 0:
        return place, 0.0
    if abs(exponent) > MOST_TENS:
        return -1, 0.0
    value = _scaled(digits, exponent, powers)
    return place, -value if negative else value


@compiled
def _is_nan(text: NDArray[np.uint8], place: int) -> bool:
    first, second, third = text[place] | 32, text[place + 1] | 32, text[place + 2] | 32
    return bool(first == 110 and second == 97 and third == 110)


@compiled
def read_cells(
    text: NDArray[np.uint8],
    start: int,
    stop: int,
    line: int,
    row: int,
    cells: Array,
    lines: Places,
    nans: Places,
    odd: Places,
    powers: Array,
    kinds: Places,
    comma: int,
) -> tuple[int, int, int, int]:
    """Read whole lines of ``text[start:stop]``; ``text`` must go on at least four bytes beyond.

    Parameters
    ----------
    text, start, stop
        Bytes; the one before ``stop`` is a newline.
    line, row
        Number of the first line, and the row of ``cells`` to fill first.
    cells, lines
        (columns, rows) and (rows,) to fill; NaN where a cell is empty.
    nans
        (columns, 3) to fill: how many cells spell NaN, in which line first and last.
    odd
        (many, 5) to fill with cells that are no plain number: row, column, first byte, byte behind,
        line. Column −1 stands for a line of another length, with its number of cells as row.
    kinds
        (columns,) of :data:`NUMBERS`, :data:`TEXT` (every cell that is not empty counts as odd) or
        :data:`UNREAD` (NaN whatever it holds).
    comma
        The byte between cells.

    Returns
    -------
    The place, line and row where reading stopped (all done, ``cells`` or ``odd`` full, a line of
    another length), and the number of odd cells.
    """
    columns, most = cells.shape
    result, place = 0, start
    while place < stop and row < most and result + columns < odd.shape[0]:
        first = place
        while text[place] == BLANK or text[place] == RETURN:
            place += 1
        if text[place] == NEWLINE:
            place, line = place + 1, line + 1
            continue
        column = 0
        while True:
            while text[place] == BLANK:
                place += 1
            behind, value = place, np.nan
            kind = kinds[column] if column < columns else NUMBERS
            if text[place] != comma and text[place] != NEWLINE and kind != NUMBERS:
                behind = -1
            elif text[place] != comma and text[place] != NEWLINE:
                behind, value = _number(text, place, powers)
                if behind < 0 and _is_nan(text, place):
                    behind, value = place + 3, np.nan
                    if column < columns:
                        nans[column, 1] = line if nans[column, 0] == 0 else nans[column, 1]
                        nans[column, 0] += 1
                        nans[column, 2] = line
            end = behind if behind >= 0 else place
            while text[end] == BLANK or (text[end] == RETURN and text[end + 1] == NEWLINE):
                end += 1
            if text[end] != comma and text[end] != NEWLINE:
                behind = -1
                while text[end] != comma and text[end] != NEWLINE:
                    end += 1
            if column < columns:
                cells[column, row] = value
                if behind < 0 and kind != UNREAD:
                    odd[result, 0], odd[result, 1], odd[result, 2] = row, column, place
                    odd[result, 3], odd[result, 4] = end, line
                    result += 1
            column += 1
            place = end + 1
            if text[end] == NEWLINE:
                break
        if column != columns:
            odd[result, 0], odd[result, 1], odd[result, 2] = column, BAD_LENGTH, first
            odd[result, 3], odd[result, 4] = place - 1, line
            return place, line + 1, row, result + 1
        lines[row] = line
        row, line = row + 1, line + 1
    return place, line, row, result
