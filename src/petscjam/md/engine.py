"""What a run needs of an engine, which advances disks and sums what they do. Units: ds, m, τe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from petscjam.base.types import Array
from petscjam.md.model import Model
from petscjam.md.state import State

BINS = 100  # of the collision angle, 3.6° each (VOT fig. 8)
TICKS = 1024  # of a step: the most parts that it can be divided into, a power of 2
# Sums over contacts and disks: L² times the elastic, dissipative and kinetic pressure tensor (VOT eqs. 12–14:
# first index force or velocity, second index separation), contacts, power of heat and of the shear stress, and
# energy brought by sudden changes of the strain rate.
SUMS = 14
(EXX, EXY, EYY, DXX, DXY, DYX, DYY, TOUCHING, HEAT, KXX, KXY, KYY, WORK, JUMPS) = range(SUMS)
# Sums of a sample: over disks θ̇, θ̇², δvx², vy² (VOT eqs. 29, 35, 36); over contacts vN², vT², and their number.
SAMPLED = 7
(SPIN, SPIN2, DVX2, VY2, NORMAL2, TANGENTIAL2, CONTACTS) = range(SAMPLED)


class Totals(NamedTuple):
    """Sums over time steps.

    Attributes
    ----------
    sums : (SUMS,)
        By the trapezoidal rule, in units of one step, but for TOUCHING (a sum over the beginnings of steps) and
        JUMPS.
    counts : (3,) integers
        Contacts made, broken, and how long the latter lasted, in ticks, :data:`TICKS` a step.
    angles : (2, BINS) integers
        Histograms of the collision angle at making and at breaking.
    """

    sums: Array
    counts: NDArray[np.int64]
    angles: NDArray[np.int64]


class Engine(Protocol):
    """Disks that are sheared step by step, and the sums of what they do.

    Attributes
    ----------
    dt, L : float
        Time step in τe, and edge of the cell in ds.
    strain, rate, time : float
        Of this moment; the rate in 1/τe.
    steps, substeps : int
        Time steps made, and the parts into which they were divided.
    rebuilds : int
        Lists of pairs made.
    most : int
        Parts into which a step was divided, the most since the last :meth:`collect`.
    CHECKPOINT : mapping
        Axes of each array of a checkpoint (:func:`petscjam.base.files.check_shapes`).
    """

    CHECKPOINT: ClassVar[Mapping[str, str]]
    dt: float
    L: float
    strain: float
    rate: float
    time: float
    steps: int
    substeps: int
    rebuilds: int
    most: int

    def __init__(self, state: State, model: Model, dt: float, integrator: str, threads: int) -> None: ...

    def __len__(self) -> int:
        """Return the number of disks."""

    @property
    def state(self) -> State:
        """The state at this moment, disks in the order of the start."""

    def advance(self, strains: Array, rates: Array, bulk: str) -> None:
        """Make K steps.

        Parameters
        ----------
        strains : (K,)
            γ at the end of each step.
        rates : (K,)
            γ̇ in each step, in 1/τe.
        bulk : str
            What a change of the rate does to the disks: ``scale`` their velocities and spins with it (VOT eqs.
            40, 41), add the change of the linear ``profile``, or leave it to the ``boundary``.

        Raises
        ------
        SolverError
            If the disks fly apart.
        """

    def collect(self) -> Totals:
        """Return the sums over the steps since the last call, and begin anew."""

    def sample(self, layers: Array, moments: Array, scatter: Array) -> Array:
        """Add what disks and contacts do at this moment.

        Parameters
        ----------
        layers : (3, M)
            Gets the number of disks, the sum of vx and the area of disks, by layer in y.
        moments : (5, 4)
            Gets the sums of V_T, V^R, V^C_T, V_N (VOT eqs. 31–34, in ds γ̇) over contacts, and of their products.
        scatter : (4,)
            Gets these four of one contact.

        Returns
        -------
        sums : (SAMPLED,)
        """

    def energy(self) -> tuple[float, float, float]:
        """Return the elastic, the peculiar kinetic and the rotational energy, in m ds²/τe²."""

    def checkpoint(self) -> dict[str, Any]:
        """Return arrays from which :meth:`restored` goes on bit for bit; :meth:`collect` comes first."""

    @classmethod
    def restored(cls, saved: Mapping[str, Any], model: Model, dt: float, integrator: str, threads: int) -> Engine:
        """Return the engine of a checkpoint.

        Parameters
        ----------
        saved : mapping of str to arrays
            Of :meth:`checkpoint`.
        model : Model
        dt : float
            τe.
        integrator : str
            A name from ``INTEGRATORS``.
        threads : int

        Raises
        ------
        InputError
            If the arrays contradict each other.
        """
