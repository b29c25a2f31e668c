"""Argument types: numbers, lists and ranges from text."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from petscjam.base.errors import shown
from petscjam.base.ranges import Range

if TYPE_CHECKING:
    from petscjam.base.types import Array

MOST = 1_000_000  # seeds, or points of a range
DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
WHOLE = re.compile(r"[+-]?\d+", re.ASCII)


def parsed(text: str) -> float:
    """Return the finite number in ``text``, in the notation of C or Fortran (1.5D-3).

    All numbers are parsed here, because Python's ``float`` also accepts ``1_5``.

    Raises
    ------
    ValueError
        If it is none.
    """
    text = text.strip()
    value = float(text.replace("D", "e").replace("d", "e")) if DECIMAL.fullmatch(text) else float("nan")
    if not abs(value) < float("inf"):
        raise ValueError(f"{text!r} is not a finite number")
    return value


def parsed_whole(text: str) -> int:
    """Return the whole number in ``text``, written in decimal digits.

    Raises
    ------
    ValueError
        If it is none.
    """
    if not WHOLE.fullmatch(text.strip()):
        raise ValueError(f"{text!r} is not a whole number")
    return int(text)


@dataclass(frozen=True)
class Within:
    """The parser ``parse``, with all numbers restricted to ``range``."""

    parse: Callable[[str], Any]
    range: Range

    def __call__(self, text: str) -> Any:
        """Parse ``text``."""
        found = self.parse(text)
        for value in found if isinstance(found, Iterable) else [found]:
            if value not in self.range:
                raise argparse.ArgumentTypeError(f"must be {self.range}, not {shown(value)}")
        return found


def path(text: str) -> Path:
    """Parse the name of a file or a folder; an empty name, for Python the current folder, is refused."""
    if not text:
        raise argparse.ArgumentTypeError("the name is empty")
    return Path(text)


def number(text: str) -> float:
    """Parse a finite number."""
    try:
        return parsed(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def integer(text: str) -> int:
    """Parse a whole number."""
    try:
        return parsed_whole(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def numbers(text: str) -> list[float]:
    """Parse ``A,B,…`` or ``A:B:N``, evenly in the logarithm, both ends counted."""
    if ":" in text:
        return [float(value) for value in points(text)]
    return [number(part) for part in text.split(",")]


def whole(text: str) -> list[int]:
    """Parse ``A,B,…``."""
    try:
        return [parsed_whole(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a whole number nor a list A,B,…") from None


def seeds(text: str) -> list[int]:
    """Parse ``A:B``, both counted, or ``A,B,…``."""
    if ":" not in text:
        return whole(text)
    try:
        first, last = (parsed_whole(part) for part in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a range A:B of whole numbers") from None
    if last < first:
        raise argparse.ArgumentTypeError(f"{text!r} is an empty range")
    if last - first >= MOST:
        raise argparse.ArgumentTypeError(f"{text!r} has more than {MOST} seeds")
    return list(range(first, last + 1))


def points(text: str) -> Array:
    """Parse ``A:B:N`` (evenly in the logarithm, both ends counted) or ``A,B,…``, all above 0."""
    import numpy as np

    count: int | None = None
    try:
        if ":" in text:
            *parts, last = text.split(":")
            count = parsed_whole(last)
        else:
            parts = text.split(",")
        values = np.array([parsed(part) for part in parts])
        if count is not None and len(values) != 2:
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither A:B:N nor a list A,B,…") from None
    for value in values[~(values > 0)]:
        raise argparse.ArgumentTypeError(f"{value:g} is not above 0")
    if count is None:
        return values
    if count < 1:
        raise argparse.ArgumentTypeError(f"the range {text} is empty")
    if count > MOST:
        raise argparse.ArgumentTypeError(f"the range {text} has more than {MOST} points")
    if count == 1 and values[0] != values[1]:
        raise argparse.ArgumentTypeError(f"the range {text} has two ends but one point")
    # Rounded: the points that two ranges share are the same numbers.
    return np.array([float(f"{x:.12g}") for x in np.geomspace(values[0], values[1], count)])


def frequencies(text: str) -> Array:
    """Parse :func:`points`; a range goes up."""
    omega = points(text)
    if ":" in text and omega[-1] < omega[0]:
        raise argparse.ArgumentTypeError(f"the range {text} is empty")
    return omega


def evenly(text: str) -> list[float]:
    """Parse ``A,B,…`` or ``A:B:N``, evenly, both ends counted."""
    if ":" not in text:
        return [number(part) for part in text.split(",")]
    first, last, count = triple(text)
    if count != int(count) or not 2 <= count <= MOST:
        raise argparse.ArgumentTypeError(f"{text!r}: a range A:B:N has from 2 to {MOST} points")
    step = (last - first) / (count - 1)
    return [float(f"{first + k * step:.12g}") for k in range(int(count))]


def triple(text: str) -> tuple[float, float, float]:
    """Parse ``A:B:C``."""
    values = [number(part) for part in text.split(":")]
    if len(values) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not A:B:C")
    return values[0], values[1], values[2]


def pairs(text: str) -> list[tuple[float, float]]:
    """Parse ``A:B,C:D,…``."""
    found = [[number(part) for part in one.split(":")] for one in text.split(",")]
    if any(len(one) != 2 for one in found):
        raise argparse.ArgumentTypeError(f"{text!r} is not a list A:B,…")
    return [(a, b) for a, b in found]


def diameters(text: str) -> dict[str, float]:
    """Parse ``TYPE:DIAMETER,…``."""
    found: dict[str, float] = {}
    for one in text.split(","):
        kind, colon, value = one.rpartition(":")
        if not (colon and kind.strip()) or kind.strip() in found:
            raise argparse.ArgumentTypeError(f"{text!r} is not a list TYPE:DIAMETER,…, each type once")
        found[kind.strip()] = number(value)
    return found


def engine(parser: argparse._ActionsContainer) -> None:
    """Add the option of the engine of sheared disks."""
    text = "of sheared disks: cpu, or cuda: an NVIDIA GPU, with many runs at a time (default cpu)"
    parser.add_argument("--engine", default="cpu", metavar="NAME", help=text)
