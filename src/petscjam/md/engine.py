"""The interface of an engine, which advances disks and sums observables. Units: ds, m, τe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from petscjam.base.types import Array
from petscjam.md.model import Model
from petscjam.md.state import State

BINS = 100  # of the collision angle, 3.6° each (VOT fig. 8)
TICKS = 1024  # of a step: largest number of parts, a power of 2
# Sums over contacts and disks: Lx Ly times the elastic, dissipative and kinetic pressure tensor (VOT eqs. 12–14:
# first index force or velocity, second index separation), contacts, power of heat and of the shear stress, and
# energy brought by sudden changes of the strain rate.
SUMS = 14
(EXX, EXY, EYY, DXX, DXY, DYX, DYY, TOUCHING, HEAT, KXX, KXY, KYY, WORK, JUMPS) = range(SUMS)
# Sums of a sample: over disks θ̇, θ̇², δvx², vy² (VOT eqs. 29, 35, 36); over contacts vN², vT², and their number.
SAMPLED = 7
(SPIN, SPIN2, DVX2, VY2, NORMAL2, TANGENTIAL2, CONTACTS) = range(SAMPLED)

# Sums by layer in y: disks, vx, area, and the volume times P_xx, P_xy and P_yy, of contacts (half at each disk) and
# of peculiar velocities.
LAYERED = 6


class Totals(NamedTuple):
    """Sums over time steps.

    Attributes
    ----------
    sums : (SUMS,)
        By the trapezoidal rule, in units of one step, except TOUCHING (a sum over the beginnings of steps) and
        JUMPS.
    counts : (3,) integers
        Contacts made, contacts broken, and the duration of the broken ones in ticks, :data:`TICKS` per step.
    angles : (2, BINS) integers
        Histograms of the collision angle at making and at breaking.
    """

    sums: Array
    counts: NDArray[np.int64]
    angles: NDArray[np.int64]


class Advance(NamedTuple):
    """Steps that a run is about to make (:meth:`Engine.advance`); ``closes`` if a row of its time series ends there."""

    engine: Any
    strains: Array
    rates: Array
    bulk: str
    closes: bool


class Engine(Protocol):
    """Disks that are sheared step by step, and the sums of observables.

    Attributes
    ----------
    dt : float
        Time step in τe.
    length, height : float
        Edges Lx and Ly of the cell, in ds.
    strain, rate, time : float
        At the current time; the rate in 1/τe.
    steps, substeps : int
        Time steps made, and the parts into which they were divided.
    rebuilds : int
        Lists of pairs made.
    most : int
        Largest number of parts of a step since the last :meth:`collect`.
    CHECKPOINT : mapping
        Axes of each array of a checkpoint (:func:`petscjam.base.files.check_shapes`); angles only if they are kept.
    """

    CHECKPOINT: ClassVar[Mapping[str, str]]
    dt: float
    length: float
    height: float
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
        """The current state, disks in the order of the start."""

    def advance(self, strains: Array, rates: Array, bulk: str) -> None:
        """Make K steps.

        Parameters
        ----------
        strains : (K,)
            γ at the end of each step.
        rates : (K,)
            γ̇ in each step, in 1/τe.
        bulk : str
            Effect of a change of the rate: ``scale`` velocities and spins with the rate (VOT eqs. 40, 41), add
            the change of the linear ``profile``, or move only the ``boundary``.

        Raises
        ------
        SolverError
            If velocities diverge.
        """

    def collect(self) -> Totals:
        """Return the sums over the steps since the last call, and set them to zero."""

    @property
    def now(self) -> Array:
        """Sums of the current state, (SUMS,), as :meth:`collect` adds them, but without a fluid's viscosity and JUMPS.

        Contacts that were made or broken in the last step are counted.
        """

    def sample(self, layers: Array, moments: Array, scatter: Array) -> Array:
        """Add observables of disks and contacts of the current state.

        Parameters
        ----------
        layers : (LAYERED, M)
            Sums over disks and contacts by layer in y; is increased.
        moments : (5, 4)
            Sums of V_T, V^R, V^C_T, V_N (VOT eqs. 31–34, in ds γ̇) over contacts, and of their products; is
            increased.
        scatter : (4,)
            These four of one contact; is overwritten.

        Returns
        -------
        sums : (SAMPLED,)
        """

    def energy(self) -> tuple[float, float, float]:
        """Return the elastic, the peculiar kinetic and the rotational energy, in m ds²/τe²."""

    def checkpoint(self) -> dict[str, Any]:
        """Return arrays from which :meth:`restored` continues bit for bit; call :meth:`collect` before."""

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
            If the arrays are inconsistent.
        """
