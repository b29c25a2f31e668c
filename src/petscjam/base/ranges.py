"""The range of every number that a user gives, for the command and for the functions.

The limits are those of physics or of arithmetic: beyond them squares and quotients overflow or underflow, or HDF5
cannot store the integer. Values inside the range that need too many steps or too much memory are refused by
:func:`petscjam.parallel.memory.require` and :data:`MOST_STEPS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from petscjam.base.errors import InputError, shown


@dataclass(frozen=True)
class Range:
    """Numbers from ``low`` to ``high``, both included; with ``whole`` only whole numbers."""

    low: float
    high: float
    whole: bool = False

    def __contains__(self, value: object) -> bool:
        kind = Integral if self.whole else Real
        if not isinstance(value, kind) or isinstance(value, bool):
            return False
        number: Any = value
        return bool(self.low <= number <= self.high)

    def __str__(self) -> str:
        return f"{'a whole number ' * self.whole}from {self.low:g} to {self.high:g}"

    def check(self, what: str, value: object) -> None:
        """Refuse a ``value`` outside the range.

        Parameters
        ----------
        what : str
            Name of the argument.
        value : object

        Raises
        ------
        InputError
            It names ``what``, the value and the range.
        """
        if value not in self:
            raise InputError(f"{what} must be {self}, not {shown(value)}")


SEED = Range(0, 2**63 - 1, whole=True)  # as HDF5 stores it
RANKS = Range(1, 1e6, whole=True)
THREADS = Range(1, 4096, whole=True)
MOST_STEPS = 10**11  # time steps of a run: at 10⁸ disk steps a second, hours for 16 disks
MOST_ROWS = 10**6
MOST_RUNS = 10**6  # of a grid, packings of a library

# Packings
PREPARED = Range(8, 1e8, whole=True)
RATIO = Range(0.01, 100)
COMPOSITION = Range(0, 1)
POLYDISPERSITY = Range(0, 0.3)
BUDGET = Range(1, 1e15, whole=True)
INDEX = Range(0, 1e9, whole=True)

# Response: the squares of the lowest and of the highest frequency are finite and above 0
OMEGA = Range(1e-100, 1e100)
TIME = Range(0, 1e100)
INERTIA = Range(1e-50, 1e50)  # masses, in units of k τ1²
FRICTION = Range(0, 1e9)  # every number that a damping law takes
COMPRESSION = Range(0, 0.1)
MODES = Range(1, 1e6, whole=True)
MOMENTS = Range(2, 1e6, whole=True)
VECTORS = Range(2, 1e5, whole=True)
DPI = Range(10, 2400)
STRESS = Range(1e-50, 1e50)
ALPHA = Range(0.01, 100)
QUASISTATIC = Range(1e-10, 10)  # sizes of strains; events are located to 1e-10
EVENTS = Range(1, 1e6, whole=True)

# Sheared disks, in units of VOT
SHEARED = Range(16, 1e8, whole=True)
PHI = Range(1e-4, 1)
Q = Range(1e-9, 1e20)
EXPONENT = Range(2, 100)
DRAG = Range(0, 1e9)
MASS = Range(1e-6, 1e6)
THINNING = Range(0.01, 1)  # exponent of nonlinear drag
SPEED = Range(1e-50, 1e50)
DT = Range(1e-12, 200)
RATE = Range(-100, 100)
RATE_SIZE = Range(1e-30, 100)
STRAIN = Range(1e-30, 1e15)
KAPPA = Range(1e-15, 10)
AMPLITUDE = Range(1e-30, 100)
SWING = Range(1e-30, 100)
CYCLES = Range(1e-9, 1e12)
ROW_TIME = Range(1e-12, 1e15)
FRAMES = Range(0, 1e6, whole=True)
MOST_CHANGES = 1000  # of the strain rate: an attribute of HDF5 holds 64 kB
