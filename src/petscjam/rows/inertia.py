"""M: masses and moments of inertia of the disks.

A = K + iωB − ω²M acts on the motion relative to the affine one, so M has no coupling to the strain
(docs/theory.md, Inertia).

Axes: i disk.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from petscjam.base.errors import InputError, shown
from petscjam.base.ranges import INERTIA
from petscjam.base.types import Array
from petscjam.rows.kinematics import Form, Mask, StrainMode


def masses_of(mass: ArrayLike, n: int) -> Array:
    """Return the masses of ``n`` disks, checked.

    Parameters
    ----------
    mass : float or (n,)
        Of every disk, or of each one, in units of k τ1².
    n : int

    Raises
    ------
    InputError
        If it is not one number or ``n`` of them, or one is out of range.
    """
    try:
        given = np.asarray(mass, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"mass: must be a number, or one for each disk, not {shown(mass)}") from None
    if given.shape not in ((), (n,)):
        raise InputError(f"mass: must be a number, or {n} numbers, one for each disk, not of shape {given.shape}")
    for value in given[~((given >= INERTIA.low) & (given <= INERTIA.high))].ravel():
        INERTIA.check("mass: masses", float(value))
    return np.full(n, given)


def said(masses: Array | None) -> str:
    """Return masses as text: one number, or the range; empty without inertia."""
    if masses is None:
        return ""
    low, high = masses.min(), masses.max()
    return f"mass {low:.12g}" if low == high else f"masses from {low:.12g} to {high:.12g}"


def inertia_form(
    masses: Array, radii: Array, mean_diameter: float, my_disks: Mask, strains: Sequence[StrainMode]
) -> Form:
    """Return M: m on ux and uy, and m ρ²/2, the moment of inertia of a homogeneous disk, on θ.

    Parameters
    ----------
    masses, radii : (N,)
    mean_diameter : float
        Rotations are θ times this length.
    my_disks : (N,) bool
        Disks of this rank.
    strains : sequence of StrainMode
    """
    spins = masses * (radii / mean_diameter) ** 2 / 2
    weights = np.column_stack([masses, masses, spins])[my_disks].ravel()
    places = np.flatnonzero(np.repeat(my_disks, 3))
    count, S = len(places), len(strains)
    rows = csr_array((np.ones(count), (np.arange(count), places)), shape=(count, 3 * len(masses)))
    mine = np.ones(count, dtype=bool)
    return Form(rows, np.zeros((count, S)), weights, 0.0, np.zeros((S, S)), mine, my_disks)
