"""Positions and velocities of disks at one time, in a cell with Lees–Edwards boundaries.

The edges of the cell are (Lx, 0) and (γLy, Ly). The images of a disk at (x, y) with velocity (vx, vy) are at
(x + mLx + nγLy, y + nLy) with (vx + nγ̇Ly, vy).

Axes: i disk, x Cartesian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from petscjam.base import ranges
from petscjam.base.errors import InputError, shown
from petscjam.base.tables import Table, Tabular
from petscjam.base.types import Array, frozen
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.geometry.potential import Potential, potential
from petscjam.parallel.memory import require

RATIO = 1.4
BYTES_PER_DISK = 1000  # of a simulation: disks, pairs, sums, and output


@dataclass(frozen=True, eq=False)
class State(Tabular):
    """Positions and velocities of disks. Units: ds, m, τe.

    Parameters
    ----------
    positions : (N, 2)
        Any periodic images, with the velocities of the same images.
    velocities : (N, 2)
        In the laboratory; a linear profile has vx = γ̇ y.
    spins : (N,)
        Angular velocities θ̇.
    radii : (N,)
    length : float
        Lx.
    strain, rate, time : float
        γ, γ̇ and t. The tilt of a cell is part of γ.
    potential_name : str
        Of the repulsion, as in a :class:`petscjam.Packing`; its energy scale is 1 for disks of diameter ds.
    height : float
        Ly; default: Lx.
    angles : (N,)
        Angles θ by which the disks have turned; None: not kept.

    Raises
    ------
    InputError
        On wrong shapes, values that are not finite, a radius that is not positive, an unknown potential.
    """

    positions: Array
    velocities: Array
    spins: Array
    radii: Array
    length: float
    strain: float = 0.0
    rate: float = 0.0
    time: float = 0.0
    potential_name: str = "harmonic-relative"  # VOT eq. 1 with α = 2
    height: float = None  # type: ignore[assignment]
    angles: Array | None = None

    def facts(self) -> dict[str, Any]:
        """Return size, cell, strain, rate and time, by name."""
        cell = f"{self.length:.5g} × {self.height:.5g}"
        return {"disks": len(self.radii), "cell": cell, "strain": self.strain, "rate": self.rate, "time": self.time}

    def flat(self) -> Table:
        """Return a line for each disk: position, velocity, spin and radius."""
        (x, y), (vx, vy) = self.positions.T, self.velocities.T
        columns = {"x": x, "y": y, "vx": vx, "vy": vy, "spin": self.spins, "radius": self.radii}
        units = {"x": "ds", "y": "ds", "vx": "ds/tau_e", "vy": "ds/tau_e", "spin": "1/tau_e", "radius": "ds"}
        return Table(columns, units)

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.radii))
        shapes = {"positions": (n, 2), "velocities": (n, 2), "spins": (n,), "radii": (n,)}
        shapes |= {} if self.angles is None else {"angles": (n,)}
        for name, shape in shapes.items():
            values = frozen(getattr(self, name))
            if values.shape != shape:
                raise InputError(f"state: {name} must have shape {shape}, not {values.shape}")
            bad = ~np.isfinite(values) if name != "radii" else ~((values > 0) & np.isfinite(values))
            if bad.any():
                i = int(np.argwhere(bad)[0, 0])
                raise InputError(f"state: {name} of disk {i}: {values[i]}")
            object.__setattr__(self, name, values)
        object.__setattr__(self, "height", self.length if self.height is None else self.height)
        for name in ("length", "height", "strain", "rate", "time"):
            value = float(getattr(self, name))
            if not np.isfinite(value) or (name in ("length", "height") and value <= 0):
                raise InputError(f"state: {name} is {value}")
            object.__setattr__(self, name, value)
        potential(self.potential_name)

    def __len__(self) -> int:
        return len(self.radii)

    @property
    def area(self) -> float:
        """Lx Ly."""
        return self.length * self.height

    @property
    def phi(self) -> float:
        """Packing fraction (VOT eq. 11)."""
        return float(np.pi * (self.radii**2).sum() / self.area)

    @property
    def box(self) -> Box:
        """The sheared cell, its second edge tilted by γLy modulo Lx, at most by Lx/2."""
        tilt = self.strain * (self.height / self.length)
        return Box(np.array([[self.length, 0.0], [(tilt - np.rint(tilt)) * self.length, self.height]]))

    @property
    def potential(self) -> Potential:
        """The repulsion between disks."""
        return potential(self.potential_name)

    @property
    def peculiar(self) -> Array:
        """Velocities relative to the linear profile, v − γ̇ y x̂, shape (N, 2)."""
        c = self.velocities.copy()
        c[:, 0] -= self.rate * self.positions[:, 1]
        return c

    def wrapped(self) -> State:
        """Return the same state by the images with 0 ≤ x < Lx and 0 ≤ y < Ly."""
        from petscjam.md.neighbours import wrap

        q = np.column_stack([self.positions, self.velocities])
        wrap(q, self.length, self.height, self.strain, self.rate)
        return replace(self, positions=q[:, :2], velocities=q[:, 2:])

    def packing(self) -> Packing:
        """Return positions, radii and cell as a :class:`petscjam.Packing`, not minimised."""
        return Packing(self.positions, self.radii, self.box, self.potential_name)


def radii(n: int) -> Array:
    """Return the radii of VOT: half of the disks of diameter 1, half of 1.4."""
    ranges.SHEARED.check("shear: the number of disks", n)
    if n % 2:
        raise InputError(f"shear: the number of disks must be even, not {shown(n)}")
    return np.where(np.arange(n) < n // 2, 0.5, 0.5 * RATIO)


def cell_length(sizes: Array, phi: float) -> float:
    """Return the edge L of the square cell (VOT eq. 11).

    Parameters
    ----------
    sizes : (N,)
        Radii.
    phi : float
        Packing fraction.

    Raises
    ------
    InputError
        If ``phi`` is out of range.
    """
    ranges.PHI.check("shear: the packing fraction phi", phi)
    return float(np.sqrt(np.pi * (sizes**2).sum() / phi))


def random_state(n: int, phi: float, seed: int, potential_name: str = "harmonic-relative") -> State:
    """Return disks at rest, at random positions: they overlap.

    Parameters
    ----------
    n : int
        Disks.
    phi : float
        Packing fraction.
    seed : int
    potential_name : str

    Raises
    ------
    InputError
        If ``seed`` or ``phi`` is out of range, or the memory is too small.
    """
    ranges.SEED.check("shear: the seed", seed)
    require(BYTES_PER_DISK * n, f"shear: {n} disks")
    sizes = radii(n)
    L = cell_length(sizes, phi)
    x = np.random.default_rng(seed).random((n, 2)) * L
    return State(x, np.zeros((n, 2)), np.zeros(n), sizes, L, potential_name=potential_name)
