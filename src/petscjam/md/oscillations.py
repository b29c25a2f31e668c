"""Oscillatory shear: the moduli G′ and G″ at the frequency of the strain, and harmonics of the stress.

Axes: k row, h harmonic, c cycle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.geometry.neighbours import pairs
from petscjam.md.result import Mean, Run, blocked_error

ORDERS = (1, 3, 5)  # of the harmonics in ``info``
STEADY = ("P elastic", "P", "Z")  # time means that ``info`` prints of an oscillation, too


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Moduli Gn of σ(t) = γ0 Σn [Gn′ sin nωt + Gn″ cos nωt], where γ(t) = γ0 sin ωt; even n are left out.

    Attributes
    ----------
    amplitude, omega : float
        γ0, and ω in 1/τe.
    orders : (H,) integers
        n = 1, 3, …; those that the rows of a cycle resolve.
    moduli : (H,) complex
        Gn′ + iGn″ in m/τe²; the first is G*(ω) at the amplitude γ0.
    errors : (H,) complex
        Standard errors of Gn′ and of Gn″ over the cycles; NaN if there is one only.
    cycles : int
        Evaluated cycles, after the first ones are left out.
    """

    amplitude: float
    omega: float
    orders: NDArray[np.int64]
    moduli: NDArray[np.complex128]
    errors: NDArray[np.complex128]
    cycles: int

    @property
    def modulus(self) -> complex:
        """G*(ω) = G′ + iG″, the first harmonic."""
        return complex(self.moduli[0])

    @property
    def means(self) -> dict[str, Mean]:
        """Gn′ and Gn″ with their errors, by symbol."""
        found = {}
        for n, g, error in zip(self.orders, self.moduli, self.errors, strict=True):
            index = "" if n == 1 else f"{n}"
            found[f"G{index}′"] = Mean(float(g.real), float(error.real))
            found[f"G{index}″"] = Mean(float(g.imag), float(error.imag))
        return found


def harmonics(run: Run, skip: int | None = None, orders: Sequence[int] = ORDERS) -> Harmonics:
    """Return the moduli of an oscillation, from a least-squares fit to the stress of each cycle.

    The fit contains the mean and all harmonics up to the largest of ``orders``, at least 5, each averaged over the
    time of a row, because rows are averages. In the rows the damping of the affine motion is half a time step early
    (with one evaluation a step: late), because the rate changes from step to step; this changes G′ by −ω² η∞ dt/2
    (+), with the viscosity η∞ of the affine motion, and is corrected with η∞ of the last state, if the drag is linear.

    Parameters
    ----------
    run : Run
    skip : int
        Cycles to leave out at the start; default: a quarter of the complete ones, at least one if there are two.
    orders : sequence of int

    Raises
    ------
    InputError
        If the run is not an oscillation, or has no complete cycle left, or too few rows in a cycle.
    """
    s = run.settings
    if s.protocol != "oscillation":
        raise InputError(f"oscillation: the run is not one, but of the protocol {s.protocol!r}")
    omega, amplitude = s.history["omega"], s.history["amplitude"]
    end = (run.time - s.time0) * omega  # phases
    middle, width = (end + np.append(0, end[:-1])) / 2, np.diff(end, prepend=0)
    cycle, complete = np.floor(middle / (2 * np.pi)).astype(int), int((end[-1] + omega * s.dt) / (2 * np.pi))
    skip = max(complete // 4, int(complete > 1)) if skip is None else skip
    if complete <= skip:
        raise InputError(f"oscillation: {complete} complete cycles, of which {skip} are left out")
    fewest = int(np.bincount(cycle, minlength=complete)[skip:complete].min())
    n = np.arange(1, min(max(*orders, *ORDERS), fewest // 2 - 1) + 1)
    shown = n[np.isin(n, orders)]
    if not len(shown):
        need = 2 * min(orders) + 2
        raise InputError(f"oscillation: {fewest} rows in a cycle, at least {need} are needed: take a smaller row_time")
    mean, phase = np.sinc(np.outer(width, n) / (2 * np.pi)), np.outer(middle, n)
    design = np.column_stack([mean * np.sin(phase), mean * np.cos(phase), np.ones(len(end))])
    stress, kept = run.stress, [cycle == c for c in range(skip, complete)]
    fits = np.array([np.linalg.lstsq(design[rows], stress[rows], rcond=None)[0] for rows in kept])
    storage, loss = fits[:, shown - 1] / amplitude, fits[:, len(n) + shown - 1] / amplitude
    if shown[0] == 1:
        part = s.dt * len(end) / run.rows["parts"].sum()
        storage[:, 0] += (1 if s.integrator == "heun" else -1) * omega**2 * _affine_viscosity(run) * part / 2
    moduli = storage.mean(0) + 1j * loss.mean(0)
    errors = [complex(over_cycles(a), over_cycles(b)) for a, b in zip(storage.T, loss.T, strict=True)]
    return Harmonics(amplitude, omega, shown, moduli, np.array(errors), len(fits))


def _affine_viscosity(run: Run) -> float:
    """Return Σ ry² (kn nx² + kt ny²)/V over the contacts of the last state: the stress of the affine motion over γ̇."""
    state, model = run.state, run.settings.model
    if model.film is not None:
        return 0.0
    x, y = pairs(state.box, state.positions, state.radii)[2].T
    return float(np.sum(y**2 * (model.normal * x**2 + model.tangential * y**2) / (x**2 + y**2)) / state.area)


def over_cycles(values: Array) -> float:
    """Return the standard error of the mean of ``values``, one of each cycle, (C,); NaN if there is one cycle."""
    return blocked_error(values) if len(values) > 1 else np.nan


def summary(run: Run) -> dict[str, Mean]:
    """Return the means of a run for ``info``, by symbol; of an oscillation its moduli, P and Z.

    Raises
    ------
    InputError
        If the run is too short.
    """
    means = run.means()
    if run.settings.protocol != "oscillation":
        return means
    return harmonics(run).means | {name: means[name] for name in STEADY if name in means}
