"""The quasi-static response as a sum over the lowest modes, compared with the direct solve (BT Fig. 5).

Axes: m mode, k number of modes, a motion (parallel, transverse, non-affine).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from petscjam.analysis.nonaffine import MOTIONS, quasistatic_response
from petscjam.base.progress import Progress, part, reporting
from petscjam.base.types import Array, Integers
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm
from petscjam.response.modes import lowest_modes
from petscjam.response.origin import Result, stored

POINTS = 40  # numbers of modes, evenly in their logarithm


@dataclass(frozen=True, eq=False)
class ModeSum(Result):
    """The response per unit strain as a sum over the lowest modes of K. Units as in :class:`Modes`.

    Attributes
    ----------
    counts : (K,)
        Numbers of lowest modes.
    medians : (3, K)
        Medians of |Δu∥| and |Δu⊥| over contacts and of |u_na| over disks, from the affine motion and the
        lowest modes.
    direct : (3,)
        The same of the direct solve.
    frequencies, floppiness, participation, softening : (M,)
        Of each mode, as in :class:`Modes`.
    modes : int
        Number of all modes, 2n − 2.
    complete : bool or None
        Whether it is proved that no mode was missed.
    """

    counts: Integers = field(metadata=stored(axes="K"))
    medians: Array = field(metadata=stored("length per unit strain", "3 K", finite=True))
    direct: Array = field(metadata=stored("length per unit strain", "3", finite=True))
    frequencies: Array = field(metadata=stored("(stress/mass)^1/2", "M", finite=True))
    floppiness: Array = field(metadata=stored(axes="M"))
    participation: Array = field(metadata=stored(axes="M", finite=True))
    softening: Array = field(metadata=stored("stress", "M"))
    modes: int
    complete: bool | None
    settings: ClassVar[tuple[str, ...]] = ("strain",)
    units: ClassVar[str] = "medians from the lowest modes, divided by those of the direct solve"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        ratios = {f"{motion} / direct": self.ratios[k, -1] for k, motion in enumerate(MOTIONS)}
        return {"modes": f"{self.counts[-1]} of {self.modes}", **ratios}

    @property
    def ratios(self) -> Array:
        """Medians from the lowest modes divided by those of the direct solve, (3, K)."""
        return self.medians / self.direct[:, None]


def modes_needed(ratios: ArrayLike, counts: ArrayLike, within: float = 0.1) -> float:
    """Return the smallest number of modes from which on a median is close to that of the direct solve.

    Parameters
    ----------
    ratios : (K,)
        Medians from the lowest modes divided by that of the direct solve.
    counts : (K,)
        Numbers of modes, ascending.
    within : float
        Largest difference of a ratio from 1.

    Returns
    -------
    float
        NaN if none of the numbers is sufficient.
    """
    off = np.flatnonzero(abs(np.asarray(ratios) - 1) > within)
    first = off[-1] + 1 if len(off) else 0
    return float(np.asarray(counts)[first]) if first < len(np.asarray(counts)) else np.nan


@reporting
def mode_sum(
    packing: Packing,
    count: int = 50,
    *,
    prestress: bool = True,
    strain: str = "simple-shear",
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> ModeSum:
    """Return the convergence of the response at ω → 0 with the number of modes; the vectors are not stored.

    Parameters
    ----------
    packing, count, prestress, strain, comm, name, progress
        As for :func:`petscjam.lowest_modes`; sums have up to ``count`` modes.

    Raises
    ------
    InputError, SolverError
        As :func:`petscjam.lowest_modes` and :func:`petscjam.quasistatic_response`.
    """
    settings: dict[str, Any] = {"prestress": prestress, "strain": strain, "comm": comm, "name": name}
    found = lowest_modes(packing, count, **settings, progress=progress and part(progress, 0, 2))
    direct = quasistatic_response(packing, **settings, progress=progress and part(progress, 1, 2))
    counts = np.unique(np.geomspace(1, len(found.eigenvalues), POINTS).astype(int))
    medians = np.empty((len(MOTIONS), len(counts)))
    for k, m in enumerate(counts):
        motion = found.response(int(m))
        sizes = abs(motion.parallel), abs(motion.transverse), np.linalg.norm(motion.nonaffine, axis=1)
        medians[:, k] = [np.median(size) for size in sizes]
    return ModeSum(
        counts=counts,
        medians=medians,
        direct=np.array([np.median(direct.sizes(motion)) for motion in MOTIONS]),
        frequencies=found.frequencies,
        floppiness=found.floppiness,
        participation=found.participation,
        softening=found.softening,
        modes=2 * len(found.disks) - 2,
        complete=found.complete,
        origin=found.origin,
        notes=found.notes,
    )


def rebuilt_response(*arguments: Any, **options: Any) -> ModeSum:
    """Call :func:`mode_sum`, of which this is the former name."""
    warnings.warn("rebuilt_response is now called mode_sum", FutureWarning, stacklevel=2)
    return mode_sum(*arguments, **options)
