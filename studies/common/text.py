"""Numbers as text, for tables of pages."""

from __future__ import annotations

import math


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits, large and small ones as 1.2e6."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0.0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        places = digits - 1 - math.floor(math.log10(abs(value)))
        return f"{round(value, places):.{max(0, places)}f}"
    base, exponent = f"{value:.{max(0, digits - 1)}e}".split("e")
    return f"{base}e{int(exponent)}"


def measured(value: float | None, error: float | None) -> str:
    """Return value +- error, to two digits of the error."""
    if value is None or error is None or not error > 0.0:
        return number(value, 5)
    places = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{places}f} +- {error:.{places}f}"


def percent(value: float | None, digits: int = 2) -> str:
    """Return a ratio in per cent."""
    return "-" if value is None else f"{number(100.0 * value, digits)} %"


def seconds(value: float | None) -> str:
    """Return a time in the unit that fits: us, ms, s."""
    if value is None:
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if value >= size:
            return f"{number(value / size, 2)} {unit}"
    return f"{number(value / 1e-6, 2)} us"
