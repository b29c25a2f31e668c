"""Prepare a packing: random disks, minimised, at a target pressure (BT sec. 2.1).

Axes: i disk, x Cartesian.
"""

from __future__ import annotations

from math import log
from numbers import Integral, Real

import numpy as np

from petscjam.box import Array, Box
from petscjam.errors import InputError
from petscjam.network import ContactNetwork
from petscjam.packing.certify import certify
from petscjam.packing.minimise import METHODS, Enthalpy
from petscjam.packing.packing import Packing
from petscjam.progress import Report
from petscjam.storage import release

GAP = 1e-8  # between a rattler and its neighbours, relative to the sum of their radii
PUSHES = 1000


def prepare_packing(
    n: int = 1024,
    pressure: float = 1e-3,
    seed: int = 1,
    *,
    shear_stabilised: bool = False,
    method: str = "cg",
    potential_name: str = "harmonic",
    progress: Report | None = None,
) -> Packing:
    """Return a packing of ``n`` disks in mechanical equilibrium at ``pressure``, in a square cell.

    50:50 by number, diameters 1/1.2 and 1.4/1.2 (mean d = 1; the odd disk is small). Positions are
    uniformly random, ``default_rng(seed).random((n, 2))`` in units of the cell, small disks first.
    The energy is minimised at constant volume, a little above the density at which quenches have the
    target pressure; then the enthalpy, with the edge of the cell as one more degree of freedom.

    It ends when no disk feels more than max(1e-10·p·d, 4·ε·k·L) and the pressure is within
    max(1e-9·p, 4·ε·k·L/d) of the target. The same arguments give the same packing.

    Parameters
    ----------
    n : int
        At least 8.
    pressure : float
        Target, in units of k (the spring constant of two disks whose radii add up to d).
    seed : int
    shear_stabilised : bool
        Not available yet.
    method : "cg" or "fire"
    potential_name : str
        A name from :data:`petscjam.potential.POTENTIALS`.
    progress : callable, optional
        Called now and then with the fraction done, in [0, 1], and a line of text.

    Raises
    ------
    InputError
        On an argument out of range.
    SolverError
        If the tolerances are not reached within two million force evaluations.
    """
    check(n, pressure, seed, shear_stabilised, method)
    radii = np.where(np.arange(n) < n - n // 2, 0.5 / 1.2, 0.7 / 1.2)
    length = _edge(radii, 0.845 + 2.5 * pressure)
    # Half of what is promised: whoever recomputes the forces from the file rounds differently.
    floor = _rounding_floor(length) / 2
    tolerance = max(0.5e-10 * pressure, floor)

    def report(h: Enthalpy) -> None:
        if progress is not None:
            worst = max(h.force, abs(h.pressure - pressure), tolerance)
            progress(min(1.0, max(0.0, log(worst) / log(tolerance))),
                     f"largest force {h.force:.1e}, pressure {h.pressure:.4e}")  # fmt: skip

    # A box let go before the disks have settled overshoots, and the way back along soft modes is long:
    # stopping this stage earlier costs time, the more the lower the pressure.
    minimise = METHODS[method]
    energy = Enthalpy(radii, length, potential_name=potential_name, report=report)
    x = np.random.default_rng(seed).random((n, 2)) * length
    z = minimise(energy, np.append(x, 0.0), lambda h: h.force <= 1e-3 * max(h.pressure, pressure))
    enthalpy = Enthalpy(radii, length, pressure, potential_name=potential_name, skin=0.1, report=report)
    z = minimise(
        enthalpy,
        z,
        lambda h: h.force <= tolerance and abs(h.pressure - pressure) <= max(0.5e-9 * pressure, floor),
    )
    x, scale = enthalpy.unpack(z)
    # Scaling the positions rounds them; the forces this leaves are relaxed where they will be read.
    box = Box.square(scale * length)
    x = _free_rattlers(Packing(box.wrap(scale * x), radii, box, potential_name))
    final = Enthalpy(radii, scale * length, potential_name=potential_name, skin=0.1, report=report)
    x, _ = final.unpack(minimise(final, np.append(x, 0.0), lambda h: h.force <= tolerance))
    made_by = {
        "program": "petscjam", "version": release("petscjam"),
        "numpy": release("numpy"), "numba": release("numba"),
        "n": int(n), "pressure": float(pressure), "seed": int(seed), "method": method,
        "evaluations": energy.evaluations + enthalpy.evaluations + final.evaluations,
    }  # fmt: skip
    packing = certify(Packing(x, radii, box, potential_name, provenance=made_by), pressure)
    if progress is not None:
        progress(1.0, f"largest force {final.force:.1e}, pressure {final.pressure:.4e}")
    return packing


def _free_rattlers(packing: Packing) -> Array:
    """Return positions in which no rattler rests on a neighbour, where its cage leaves it room.

    A minimiser leaves rattlers with overlaps of the order of rounding, and it would be rounding that
    decides whether they are in contact. They are pushed off by GAP.
    """
    rattler = ~ContactNetwork.of(packing).backbone
    x, radii = packing.positions.copy(), packing.radii
    i, j, r = packing.box.pairs_within(x, 2.01 * radii.max())
    loose = rattler[i] | rattler[j]
    i, j, r = i[loose], j[loose], r[loose]
    images = r - (x[j] - x[i])
    share = 1.0 / np.maximum(rattler[i].astype(int) + rattler[j], 1)
    for _ in range(PUSHES):
        r = x[j] - x[i] + images
        distance = np.hypot(r[:, 0], r[:, 1])
        overlap = np.maximum((1 + GAP) * (radii[i] + radii[j]) - distance, 0)
        if not overlap.any():
            break
        push = (share * overlap / distance)[:, None] * r
        np.add.at(x, j, push * rattler[j, None])
        np.add.at(x, i, -push * rattler[i, None])
    return x


def _edge(radii: Array, phi: float) -> float:
    return float(np.sqrt(np.pi * (radii**2).sum() / phi))


def _rounding_floor(length: float) -> float:
    """Force that positions rounded to double precision leave on a disk, 4·ε·k·L with k = 1."""
    return 4 * float(np.finfo(float).eps) * length


def check(n: int, pressure: float, seed: int, shear_stabilised: bool, method: str) -> None:
    """Raise the InputError that :func:`prepare_packing` would raise on these arguments."""
    if not isinstance(n, Integral) or n < 8:
        raise InputError(f"prepare: the number of disks must be a whole number of at least 8, not {n!r}")
    if not isinstance(pressure, Real) or not 0 < pressure < 0.5:
        raise InputError(f"prepare: the pressure must be above 0 and below 0.5 (in k), not {pressure!r}")
    lowest = 1e6 * _rounding_floor(n**0.5)
    if pressure < lowest:
        raise InputError(
            f"prepare: at a pressure of {pressure!r} rounding leaves more than 1e-6 of the forces "
            f"between {n} disks; the lowest is {lowest:.1e}"
        )
    if not isinstance(seed, Integral) or seed < 0:
        raise InputError(f"prepare: the seed must be a whole number, 0 or more, not {seed!r}")
    if method not in METHODS:
        raise InputError(f"prepare: the method {method!r} is unknown; known are {', '.join(METHODS)}")
    if shear_stabilised:
        raise InputError("prepare: shear_stabilised=True is not available yet; leave it out")
