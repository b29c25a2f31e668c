"""Nonlinear drag with a friction time for each contact, from the path of the contact.

The method of equivalent damping (BT eqs. 9, 23) without the assumption that every contact has the force δσ: (K +
iωB)q = f is solved repeatedly until B = Σ τ_c(Δu∥⊗Δu∥ + Δu⊥⊗Δu⊥) is that of the motion. docs/howto/drag.md.

Axes: w frequency, c contact of the backbone, k normal/tangential.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import hyp2f1

from petscjam.analysis.drag import NonlinearModulus, check_amplitude, equivalent_time
from petscjam.base.errors import InputError, shown
from petscjam.base.progress import Progress, reporting
from petscjam.base.types import Array
from petscjam.geometry.network import rounded
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve
from petscjam.parallel.memory import check_memory
from petscjam.parallel.petsc import petsc
from petscjam.parallel.solver import direct_solver
from petscjam.response.limits import limit_or_note, static_modulus
from petscjam.response.matrices import assembled
from petscjam.response.origin import frequencies
from petscjam.response.problem import LinearProblem, describe
from petscjam.rows.damping import ContactDamping, viscous_form
from petscjam.rows.kinematics import Field, strain_mode

MEMORY = 6  # number of previous iterations for the next one


def contact_times(velocity: Field, alpha: float, floor: float = 0.0) -> Array:
    """Return τ_c = ⟨|v|^(α+1)⟩/⟨|v|²⟩ (C,) of velocities Re(a e^{iωt}), a = ``velocity`` (C, 2).

    v runs along an ellipse: |v|² = A + D cos ψ, A = (|a_n|² + |a_t|²)/2, D = |a_n² + a_t²|/2, and
    ⟨|v|^s⟩ = A^{s/2} ₂F₁(−s/4, (2 − s)/4; 1; (D/A)²).

    Parameters
    ----------
    velocity : (C, 2) complex
        Amplitudes, normal and tangential.
    alpha : float
        Exponent of the friction.
    floor : float
        Relative to the root mean square of |v|: its square, times the mean of A, is added to A.

    Returns
    -------
    (C,)
    """
    A = (abs(velocity) ** 2).sum(1) / 2
    D = abs((velocity**2).sum(1)) / 2
    A = A + floor**2 * A.mean()
    s = alpha + 1
    ratio = np.minimum(D / A, 1.0)
    return A ** (s / 2 - 1) * hyp2f1(-s / 4, (2 - s) / 4, 1.0, ratio**2)


@reporting
def self_consistent_drag(
    packing: Packing,
    omegas: ArrayLike,
    stress: float,
    alpha: float,
    *,
    strain: str = "simple-shear",
    prestress: bool = True,
    rtol: float = 1e-6,
    floor: float = 1e-6,
    most_iterations: int = 100,
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> NonlinearModulus:
    """Return G*(ω; δσ) with a self-consistent time τ_c for each contact.

    Solves (K + iωB)q = f, B = Σ τ_c(Δu∥⊗Δu∥ + Δu⊥⊗Δu⊥) with rotations, until τ_c is that of the velocities
    iω(δσ/G*)(Δu∥, Δu⊥). For α = 1 it is ContactDamping().

    Parameters
    ----------
    omegas : (W,) array_like
        Angular frequencies in 1/τ1, all > 0.
    stress : float
        Amplitude δσ > 0 of the stress, in units of k; in compression, of the pressure.
    alpha : float
        Exponent α > 0; 1 is linear.
    rtol : float
        Converged where |ΔG*|/|G*| and the rms of Δ ln τ_c of an iteration are both below it.
    floor : float
        Velocity, relative to the root mean square over contacts, below which friction is linear: without it τ_c →
        ∞ for α < 1 if a contact hardly moves.
    most_iterations : int
        For each frequency. Results without convergence are stored, marked in ``converged`` and noted.
    packing, strain, prestress, comm, name, progress
        As for :func:`petscjam.spectrum`.

    Raises
    ------
    InputError
        As :func:`equivalent_time`; on an unknown strain, a packing without a connected backbone.
    SolverError
        If a solve fails or its residual is not small.
    """
    comm = resolve(comm)
    agree(comm, packing, omegas, stress, alpha, strain, prestress, rtol, floor, most_iterations)
    check_amplitude(stress, alpha)
    d, omega = packing.mean_diameter, frequencies(omegas)
    k = packing.potential.unit(d)
    guess = equivalent_time(omega / k, stress / k, alpha)
    for what, value in (("rtol", rtol), ("floor", floor)):
        if not 0 < value <= 0.1:
            raise InputError(f"{what}: must be > 0 and at most 0.1, not {shown(value)}")
    if most_iterations < 1:
        raise InputError(f"most_iterations: must be at least 1, not {shown(most_iterations)}")
    problem = LinearProblem(packing, ContactDamping(), [strain_mode(strain)], prestress, comm)
    log_tau, points = np.zeros(len(problem.network)), {}
    with _responses(problem) as respond:
        for done, w in enumerate(np.argsort(omega), 1):
            log_tau = log_tau + np.log(guess[w])  # from the neighbouring frequency, with the change of the uniform time

            def times_of(found: _Response, omega: float = omega[w]) -> Array:
                return contact_times(omega / k * found.strain * found.motion / d, alpha, floor)

            points[w] = _fixed_point(partial(respond, omega[w], stress), times_of, log_tau, rtol, most_iterations, comm)
            log_tau = np.log(points[w].contact_tau) - np.log(guess[w])
            if progress:
                progress(done / len(omega), f"ω = {omega[w]:.3g}, {points[w].iterations} iterations")
    return drag_result(
        problem, omega, stress, alpha, "per contact", [points[w] for w in range(len(omega))], name, strain
    )


class _Response(NamedTuple):
    """G* and the residual of its solve; Δu (C, 2) per unit strain; amplitude of the strain; ∂G*/∂τ_c (C,)."""

    G: complex
    residual: float
    motion: Field
    strain: float
    slope: Field


class Point(NamedTuple):
    """The values of :class:`NonlinearModulus` at one frequency."""

    values: complex
    tau: float
    spread: float
    iterations: int
    converged: bool
    changes: float
    tau_changes: float
    residuals: float
    contact_tau: Array


def drag_result(
    problem: LinearProblem,
    omega: Array,
    stress: float,
    alpha: float,
    form: str,
    points: list[Point],
    name: str,
    strain: str,
    third: Field | None = None,
) -> NonlinearModulus:
    """Return the result of the ``points``, with a note if some did not converge.

    Parameters
    ----------
    problem : LinearProblem
    omega : (W,)
    stress, alpha, form, third
        As in :class:`NonlinearModulus`.
    points : list of Point
        One for each frequency.
    name, strain : str
        Of the packing, and of the strain mode.
    """
    columns = zip(*points, strict=True)
    found: dict[str, Any] = dict(zip(Point._fields, map(np.array, columns), strict=True))
    if not found["converged"].all():
        lost = ", ".join(f"{w:.3g}" for w in omega[~found["converged"]])
        problem.notes.append(f"not converged in {found['iterations'].max()} iterations at ω = {lost}")
    lowest = rounded(found["values"].real, problem.rounding[0]).min()
    still = limit_or_note(partial(static_modulus, problem), problem.notes, "G0")
    return NonlinearModulus(
        omega=omega,
        stress=float(stress),
        alpha=float(alpha),
        form=form,
        **found,
        errors=np.full(len(omega), np.nan),
        third=third,
        origin=describe(problem, name, strain),
        G0=float(np.nanmin([lowest, still.G])),
        negative_modes=problem.negative_modes,
        zero_modes=problem.zero_modes,
        notes=tuple(problem.notes),
    )


def weighted_point(tau: Array, square: Array, **values: Any) -> Point:
    """Return a point with the mean of ``tau`` and its spread.

    Parameters
    ----------
    tau, square : (C,)
        Time and ⟨|v|²⟩ of each contact.
    **values
        The others.
    """
    share = tau * square / (tau * square).sum()
    mean = float(tau @ square / square.sum())
    spread = float(share @ (np.log(tau) - share @ np.log(tau)) ** 2) ** 0.5
    return Point(tau=mean, spread=spread, contact_tau=tau, **values)


def _fixed_point(
    respond: Callable[[Array], _Response],
    times_of: Callable[[_Response], Array],
    log_tau: Array,
    rtol: float,
    most_iterations: int,
    comm: Comm,
) -> Point:
    """Iterate ln τ_c from ``log_tau`` until ``times_of`` the motion are equal to τ_c."""
    tried: list[Array] = []
    missed: list[Array] = []
    iterations, converged = 0, False
    while iterations < most_iterations and not converged:
        iterations += 1
        tau = np.exp(log_tau)
        found = respond(tau)
        wanted = times_of(found)
        miss = np.log(wanted) - log_tau
        change = float(abs(found.slope @ (wanted - tau)) / abs(found.G))
        tau_change = float(np.sqrt(np.mean(miss**2)))
        tried, missed = [*tried[1 - MEMORY :], log_tau], [*missed[1 - MEMORY :], miss]
        log_tau, converged = comm.bcast((mixed(tried, missed), max(change, tau_change) < rtol))
    return comm.bcast(
        weighted_point(
            tau,
            (abs(found.motion) ** 2).sum(1),
            values=found.G,
            iterations=iterations,
            converged=converged,
            changes=change,
            tau_changes=tau_change,
            residuals=found.residual,
        )
    )


def mixed(tried: list[Array], missed: list[Array]) -> Array:
    """Return the next iterate (Anderson): the minimum of a linear model of the residual.

    Parameters
    ----------
    tried, missed : lists of (n,)
        The last iterates and their residuals.
    """
    steps, falls = (np.diff(some, axis=0).T for some in (tried, missed))
    weights = np.linalg.lstsq(falls, missed[-1], rcond=None)[0]
    return tried[-1] + missed[-1] - (steps + falls) @ weights


@contextmanager
def _responses(problem: LinearProblem) -> Iterator[Callable[[float, float, Array], _Response]]:
    """Yield the response at ω and δσ with friction times τ_c (C,): one pattern, and one symbolic analysis."""
    comm, mode, law = problem.comm, problem.strains[0], problem.law
    network, mine = problem.network, problem.ownership.owner == problem.comm.rank
    everywhere = viscous_form(network, np.ones_like(mine), problem.strains, law)
    # with random τ_c no entry is a sum that cancels, so the pattern has all entries
    times = np.random.default_rng(0).uniform(1, 2, len(network))
    pattern = viscous_form(network, mine, problem.strains, law, times)
    dofs = problem.number(problem.active)
    check_memory(comm, dofs.size)
    with (
        assembled(problem.K, pattern, dofs, comm) as frame,
        direct_solver(comm, "petscjam_", definite=problem.definite) as solver,
    ):

        def respond(omega: float, stress: float, tau: Array) -> _Response:
            B = viscous_form(network, mine, problem.strains, law, tau)
            with assembled(problem.K, pattern, dofs, comm, B) as pencil:
                pencil.combine(1, 0, 1j * omega).copy(frame.A, structure=petsc().Mat.Structure.SAME_NONZERO_PATTERN)
                forcing = (pencil.k + 1j * omega * pencil.coupling[2])[:, 0]
            solver.factor(frame.A)
            x, residual = solver.solve(-forcing)
            Q = (dofs.gather(x, comm), [1.0])
            G = problem.modulus(problem.product(problem.K, Q, Q) + 1j * omega * problem.product(B, Q, Q))
            motion = everywhere.relative(*Q).reshape(-1, 2)
            amplitude = stress * np.sqrt(mode.scale) / abs(G)  # in compression δp = 2G*s
            slope = 1j * omega * mode.scale / network.area * (motion**2).sum(1)
            return _Response(G, residual, motion, amplitude, slope)

        yield respond
