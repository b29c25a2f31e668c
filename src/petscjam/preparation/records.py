"""Arguments and results of the kernels of packing preparation, in a module without numba.

Axes: i, j disks of pair c, s strain of the cell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petscjam.base.types import Array
from petscjam.geometry.potential import Compiled


class NeighbourList(NamedTuple):
    """Pairs that may overlap; two disks in contact through two images are listed twice.

    Attributes
    ----------
    i, j : (C,) unsigned
    sigma, k : (C,)
        Sum of radii; k is that of the potential (:meth:`petscjam.geometry.potential.Potential.k`).
    chunks : (R + 1,)
        Where the pairs of each chunk start; those from chunks[R] on are pairs of two chunks or across the edge.
    image : (C − chunks[R],) complex
        Lattice translation of j for the latter, in the reference cell.
    built : (2n + S,)
        The z for which the list was made.
    skin : float
        The list has the pairs within ρi + ρj + ``skin``.
    largest : float
        Diameter of the largest disk.
    """

    i: NDArray[np.uint32]
    j: NDArray[np.uint32]
    sigma: Array
    k: Array
    chunks: NDArray[np.int64]
    image: NDArray[np.complex128]
    built: Array
    skin: float
    largest: float


class CellStrains(NamedTuple):
    """The allowed deformations of the cell, F = 1 + Σ e_s E_s, and the target pressure.

    Attributes
    ----------
    directions : (S, 2, 2)
        E_s; none at constant volume.
    weight : float
        w: z has w e_s.
    pressure : float
        Target.
    area : float
        Of the reference cell.
    """

    directions: Array
    weight: float
    pressure: float
    area: float


class System(NamedTuple):
    """Parameters of the enthalpy of z (2n + S,), and work arrays.

    Attributes
    ----------
    n : int
        Number of disks.
    cell : CellStrains
    pairs : NeighbourList
    exponent : float
        α of a power law, else 1.
    compiled : Compiled
    threads : bool
        Whether chunks are distributed over threads.
    mapped : (n,) complex
        Overwritten with F·x.
    sums : (R + 1, 4)
        Overwritten with U and the xx, xy, yy parts of Σ f r⊗n: of each chunk, and of the rest.
    """

    n: int
    cell: CellStrains
    pairs: NeighbourList
    exponent: float
    compiled: Compiled
    threads: bool
    mapped: NDArray[np.complex128]
    sums: Array


class Forces(NamedTuple):
    """Largest net force on a disk, energy U, and pressure tensor Σ f r⊗n / V (3,): xx, xy, yy."""

    force: float
    energy: float
    stress: Array


class Goal(NamedTuple):
    """Largest force on a disk, the same in units of the pressure, and largest error of the stress."""

    force: float
    relative: float
    stress: float


class Step(NamedTuple):
    """v → keep·v − push·g, then z → z + time·v."""

    keep: float
    push: float
    time: float


class Bounds(NamedTuple):
    """Largest number of gradients of a call, largest time step, and largest displacement of a step."""

    gradients: int
    time: float
    displacement: float


class Line(NamedTuple):
    """A point z with its gradient g, the direction d, and a trial point along d with its gradient."""

    z: Array
    g: Array
    d: Array
    trial: Array
    g_trial: Array
