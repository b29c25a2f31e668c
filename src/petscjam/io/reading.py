"""Common parts of the readers of packings of other programs: arguments, lines of text, and checks of columns.

Axes: i disk.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from petscjam.base.arguments import parsed
from petscjam.base.errors import InputError
from petscjam.base.types import Array, Integers

FLAT = 1e-6  # largest variation of z, in units of the smallest radius
ALIKE = 1e-5  # largest relative difference of radii and half diameters: text of six digits
DIGITS = 15  # of double precision


@dataclass(frozen=True)
class Wanted:
    """Which packing of a file is wanted, and information that the file may lack.

    Attributes
    ----------
    index : int
        Counted from 0.
    potential : str or None
    diameters : mapping or None
        From the names of types.
    """

    index: int = 0
    potential: str | None = None
    diameters: Mapping[str, float] | None = None

    def one_of(self, count: int) -> int:
        """Return the index in a file with ``count`` packings."""
        if not 0 <= self.index < count:
            raise InputError(f"there is no packing {self.index}; the file holds {count}, counted from 0")
        return self.index

    def radii(self, sizes: Mapping[str, Array], types: Sequence[str]) -> Array:
        """Return the radii: those of the file, or else by type.

        Parameters
        ----------
        sizes : mapping of str to (N,)
            The columns ``radius`` and ``diameter``, as far as the file has them.
        types : sequence of str
            Of each disk, (N,).

        Raises
        ------
        InputError
            If the columns are contradictory, or there is no radius, or two.
        """
        radii = [values / 2 if name == "diameter" else values for name, values in sizes.items()]
        if radii:
            if self.diameters is not None:
                raise InputError("the file has radii; leave out the diameters of types")
            if not np.allclose(radii[0], radii[-1], rtol=ALIKE, atol=0):
                i = int(np.argmax(abs(radii[0] - radii[-1])))
                raise InputError(f"disk {i} has {' and '.join(f'{k} {v[i]:g}' for k, v in sizes.items())}")
            return radii[0]
        known = sorted(set(types))
        if self.diameters is None:
            raise InputError(
                "there is no radius and no diameter; give the diameter of each type, in the length unit of the file: "
                f"--diameters {','.join(f'{name}:…' for name in known)}"
            )
        for name in sorted(set(known) ^ set(self.diameters)):
            what = "is given no diameter" if name in known else "occurs nowhere"
            raise InputError(f"type {name} {what}; the types are {', '.join(known)}")
        return np.array([self.diameters[name] for name in types], dtype=float) / 2


class Text:
    """The lines of a text file, stripped, without empty ones at the end.

    They are numbered from 0 here, from 1 in messages.
    """

    def __init__(self, path: Path) -> None:
        said = path.read_text(encoding="utf-8-sig", errors="replace")
        self.lines = [line.strip() for line in said.rstrip().split("\n")]
        self.ended = said != said.rstrip()

    def words(self, n: int) -> list[str]:
        """Return the words of line ``n``; commas separate, too, and # starts a comment."""
        return self.lines[n].partition("#")[0].replace(",", " ").split()

    def rows(self, first: int, end: int) -> list[int]:
        """Return the lines from ``first`` to before ``end`` that are neither blank nor comments.

        Parameters
        ----------
        first, end : int
            Numbers of lines, from 0.
        """
        return [n for n in range(first, end) if self.words(n)]

    def table(self, rows: Sequence[int], width: int, columns: Sequence[int]) -> Array:
        """Read columns of numbers.

        Parameters
        ----------
        rows : sequence of int
            Numbers of lines, from 0.
        width : int
            Words on each of them.
        columns : sequence of int
            Indices of the words, from 0.

        Returns
        -------
        (rows, columns)

        Raises
        ------
        InputError
            If a line has more or fewer words, or one of them is not a number.
        """
        table = []
        for n in rows:
            words = self.words(n)
            if len(words) != width:
                raise InputError(f"line {n + 1}: expected {width} columns, not {self.lines[n]!r}")
            table.append(numbers([words[k] for k in columns], n))
        return np.reshape(table, (len(table), len(columns)))

    def check_end(self, rows: Sequence[int]) -> None:
        """Refuse ``rows`` if the file ends within the last one: it may have lost digits."""
        if len(rows) and rows[-1] == len(self.lines) - 1 and not self.ended:
            raise InputError(
                f"line {rows[-1] + 1}: the file ends within this line, so digits may be lost; "
                "if none are, add the end of the line"
            )

    def precision(self, rows: Sequence[int], columns: Sequence[int]) -> dict[str, str]:
        """Return the number of digits, for the provenance, if it is smaller than in double precision.

        Parameters
        ----------
        rows, columns : sequence of int
            Lines and words, from 0.
        """
        words = (self.words(n)[k] for n in rows[:100] for k in columns)
        digits = max((len(digits_of(word)) for word in words), default=DIGITS)
        return {} if digits >= DIGITS else {"precision": f"{digits} digits"}


def digits_of(word: str) -> str:
    """Return the significant digits of a number in text."""
    return re.sub(r"[eEdD].*|\D", "", word).lstrip("0")


def numbers(words: Sequence[str], n: int) -> list[float]:
    """Parse words as numbers.

    Parameters
    ----------
    words : sequence of str
    n : int
        Their line, from 0.

    Raises
    ------
    InputError
        It names the line and the word.
    """
    try:
        return [parsed(word) for word in words]
    except ValueError as error:
        raise InputError(f"line {n + 1}: {error}") from None


def check_once(names: Sequence[str], n: int, what: str) -> None:
    """Refuse ``names`` on line ``n`` if one of them is there twice.

    Parameters
    ----------
    names : sequence of str
    n : int
        Their line, from 0.
    what : str
        What they name.

    Raises
    ------
    InputError
    """
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"line {n + 1}: the {what} {name} is there twice")


def check_plane(z: Array, radii: Array) -> None:
    """Refuse ``z`` that vary by more than rounding.

    Parameters
    ----------
    z, radii : (N,)

    Raises
    ------
    InputError
    """
    if z.size and np.ptp(z) > FLAT * abs(radii).min(initial=np.inf):
        raise InputError(f"not in the plane: z runs from {z.min():g} to {z.max():g}")


def by_id(ids: Array) -> Integers:
    """Return the order of ascending ids."""
    order = np.argsort(ids, kind="stable")
    twice = ids[order][1:][np.diff(ids[order]) == 0]
    for bad, what in ((ids[(ids < 0) | (ids != np.rint(ids))], "no whole number above 0"), (twice, "twice")):
        if bad.size:
            raise InputError(f"the id {bad[0]:.15g} is {what}")
    return order
