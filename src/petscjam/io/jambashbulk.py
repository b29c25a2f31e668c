"""Text of jamBashBulk, k = 1: for each packing a header, then x, y, radius in braces."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.io.reading import Text, Wanted, numbers

SAID = {"commit": r"commit (\w+)", "seed": r"srand\((\d+)\)", "P": r"P = (\S+)", "P0": r"P0= (\S+)"}


def read_jambashbulk(path: Path, wanted: Wanted) -> Packing:
    """Read a packing of jamBashBulk.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    text = Text(path)
    lines = text.lines
    headers = [n for n, line in enumerate(lines) if line.startswith("N = ")]
    n = headers[wanted.one_of(len(headers))]
    header = re.match(r"N = (\d+) ,.*L1= { (\S+) , (\S+) }\s*,L2= { (\S+) , (\S+) }", lines[n])
    if not header:
        raise InputError(f"line {n + 1}: expected 'N = … ,L = … ,L1= {{ … }} ,L2= {{ … }}', not {lines[n]!r}")
    count, cell = int(header[1]), np.reshape(numbers(header.groups()[1:], n), (2, 2))
    for at, brace in ((n + 1, "{"), (n + 2 + count, "}")):
        if at >= len(lines) or lines[at] != brace:
            at = min(at, len(lines))
            raise InputError(f"line {at + 1}: expected '{brace}': N = {count} rows in braces")
    rows = range(n + 2, n + 2 + count)
    x, y, radii = text.table(rows, 3, [0, 1, 2]).T
    origin: dict[str, Any] = {"source": path.name, "format": "jamBashBulk text", "index": wanted.index}
    said = "\n".join([*lines[: headers[0]], lines[n]])
    found = {key: re.search(pattern, said) for key, pattern in SAID.items()}
    origin["header"] = {key: match[1] for key, match in found.items() if match}
    origin |= text.precision(rows, [0, 1])
    return Packing(np.stack([x, y], axis=1), radii, Box(cell), "harmonic", provenance=origin)
