"""Where a result comes from, and whether its packing is a solid.

Axes: w frequency.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError
from petscjam.base.ranges import OMEGA
from petscjam.base.types import Array


def frequencies(omegas: ArrayLike, *, empty: bool = False) -> Array:
    """Return ``omegas`` as an array, or refuse an empty one and any that is out of range."""
    omega = np.atleast_1d(np.asarray(omegas, dtype=float)).ravel()
    if omega.size == 0 and not empty:
        raise InputError("omega: the range is empty")
    for value in omega[~((omega >= OMEGA.low) & (omega <= OMEGA.high))]:
        OMEGA.check("omega: frequencies", float(value))
    return omega


class Judged:
    """A result that tells whether its packing is a solid, by G0, the modes of K and the balance of forces."""

    @property
    def state(self: Any) -> str:
        """``stable``, or what the packing lacks for that, or what is not known.

        It is stable if G0 > 0 beyond rounding, K has neither negative nor zero modes and, with pre-stress,
        the forces balance: a linear response starts from an equilibrium. Without pre-stress contacts are
        springs at rest, which are in one anywhere.
        """
        faults = ["G0 < 0"] * (self.G0 < 0) + ["G0 = 0"] * (self.G0 == 0)
        unknown = ["G0"] * bool(np.isnan(self.G0))
        for kind, count in (("negative modes", self.negative_modes), ("zero modes", self.zero_modes)):
            faults += [f"{count} {kind}"] * bool(count)
            unknown += [kind] * (count is None)
        balanced = self.packing.get("balanced") if self.prestress else True  # older files do not tell
        if faults:
            return f"UNSTABLE: {', '.join(faults + ['not in balance'] * (balanced is False))}"
        if balanced is False:
            return "NOT IN BALANCE"
        unknown += ["balance"] * (balanced is None)
        return f"UNKNOWN: {', '.join(unknown)}" if unknown else "stable"

    @property
    def stable(self) -> bool:
        """Whether ``state`` is ``stable``."""
        return self.state == "stable"
