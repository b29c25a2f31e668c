"""The nonlinear equations of motion under oscillating stress, without equivalent damping: harmonic balance.

Kq + Σ AᵀF(Aq̇) = f cos ωt, F(v) = kτ1(|v|τ1/ρ0)^(α−1)v (BT eq. 9) on the velocities Aq̇ of the contact points. The
periodic motion is a sum of odd harmonics; friction is evaluated at equal times of half a cycle. K does no work over
a cycle and F is the gradient of a convex function, so there is one such motion. Douglas–Rachford splitting finds it:
linear friction R acts on each contact, and the difference F(v) − Rv is solved for contact by contact at each time,
exactly and without a regularisation at v → 0; then (K + inωAᵀRA)q_n = f_n for each harmonic n. docs/howto/drag.md.

Axes: w frequency, c contact of the backbone, a row of a contact (normal, tangential), h harmonic, t time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from petscjam.analysis.contact_drag import MEMORY, Point, drag_result, mixed, self_consistent_drag, weighted_point
from petscjam.analysis.drag import NonlinearModulus
from petscjam.base.errors import InputError, shown
from petscjam.base.progress import Progress, reporting
from petscjam.base.types import Array, Integers
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve, total
from petscjam.parallel.memory import check_memory
from petscjam.parallel.petsc import petsc
from petscjam.parallel.solver import direct_solver
from petscjam.response.matrices import assembled
from petscjam.response.origin import frequencies
from petscjam.response.problem import LinearProblem
from petscjam.rows.damping import ContactDamping, viscous_form
from petscjam.rows.kinematics import Field, strain_mode

START = 1e-2  # accuracy of the times of contacts: they are the start, and R


@reporting
def nonlinear_drag(
    packing: Packing,
    omegas: ArrayLike,
    stress: float,
    alpha: float,
    *,
    strain: str = "simple-shear",
    prestress: bool = True,
    points: int = 64,
    rtol: float = 1e-6,
    most_iterations: int = 200,
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> NonlinearModulus:
    """Return G*(ω; δσ) of the periodic solution of the nonlinear equations of motion (BT eqs. 9, 10).

    Contacts and stiffnesses are fixed. The stress is δσ cos ωt; G* is δσ over the fundamental of the strain. For α
    = 1 it is ContactDamping().

    Parameters
    ----------
    omegas : (W,) array_like
        Angular frequencies in 1/τ1, all > 0.
    stress : float
        Amplitude δσ > 0 of the stress, in units of k; in compression, of the pressure.
    alpha : float
        Exponent α > 0 of the force with the speed; 1 is linear.
    points : int
        Times of a cycle at which friction is evaluated, a multiple of 4: the harmonics 1, 3, …, points/2 − 1.
    rtol : float
        Converged where |ΔG*|/|G*| of an iteration and the mismatch of velocities are both below it.
    most_iterations : int
        For each frequency. Results without convergence are stored, marked in ``converged`` and noted.
    packing, strain, prestress, comm, name, progress
        As for :func:`petscjam.spectrum`.

    Raises
    ------
    InputError
        As :func:`petscjam.self_consistent_drag`; if ``points`` is not a multiple of 4 from 8 to 1024.
    SolverError
        If a solve fails or its residual is not small.
    """
    comm = resolve(comm)
    agree(comm, points, rtol)
    if points not in range(8, 1025, 4):
        raise InputError(f"points: must be a multiple of 4 from 8 to 1024, not {shown(points)}")
    if not 0 < rtol <= 0.1:
        raise InputError(f"rtol: must be > 0 and at most 0.1, not {shown(rtol)}")
    settings: dict[str, Any] = {
        "strain": strain,
        "prestress": prestress,
        "most_iterations": most_iterations,
        "comm": comm,
    }
    start = self_consistent_drag(packing, omegas, stress, alpha, rtol=START, **settings)
    omega, d = frequencies(omegas), packing.mean_diameter
    factor = (packing.potential.unit(d) * d) ** (1 - alpha)  # F(v) = factor |v|^(α−1) v
    problem = LinearProblem(packing, ContactDamping(), [strain_mode(strain)], prestress, comm)
    orders, times = np.arange(1, points // 2, 2), 2 * np.pi / points * np.arange(points // 2)
    wave = np.exp(1j * np.outer(orders, times))
    found, third = [], []
    with _responses(problem, orders) as respond:
        for w, R in enumerate(start.contact_tau):
            law = _Law(R, factor, alpha)
            point, strains = _periodic(respond(omega[w], stress, R), law, wave, rtol, most_iterations, comm)
            found.append(point)
            third.append(strains[1] / strains[0])
            if progress:
                progress((w + 1) / len(omega), f"ω = {omega[w]:.3g}, {point.iterations} iterations")
    return drag_result(problem, omega, stress, alpha, "direct", found, name, strain, third=np.array(third))


class _Motion(NamedTuple):
    """Velocities of contacts (A, H), the strains (H,), G*, and the largest residual of the solves."""

    velocity: Field
    strain: Field
    modulus: complex
    residual: float


_Respond = Callable[[Field], _Motion]  # to forces on the contacts (A, H)


def resolvent(size: Array, R: Array, factor: float, alpha: float) -> Array:
    """Return x ≥ 0 with factor·x^α + Rx = ``size``, elementwise.

    Newton's method for ln x: the logarithm of the left side is convex in it, with slopes between 1 and α.

    Parameters
    ----------
    size : (C, T)
        ≥ 0.
    R : (C, 1)
    factor, alpha : float
    """
    wanted = np.log(np.maximum(size, np.finfo(float).tiny))
    log_R, log_factor = np.log(R), np.log(factor)
    z = np.minimum((wanted - log_factor) / alpha, wanted - log_R)
    for _ in range(100):
        whole = np.logaddexp(log_factor + alpha * z, log_R + z)
        share = np.exp(log_R + z - whole)
        step = (wanted - whole) / (alpha + (1 - alpha) * share)
        z += step
        if abs(step).max() < 1e-13 * max(1.0, abs(z).max()):
            break
    return np.exp(z)


class _Law(NamedTuple):
    """F(v) = ``factor`` |v|^(α−1) v on vectors v (A, T), and R (C,)."""

    R: Array
    factor: float
    alpha: float

    def size(self, v: Array) -> Array:
        """Return |v| (C, T)."""
        return np.linalg.norm(v.reshape(len(self.R), 2, -1), axis=1)

    def scaled(self, v: Array, length: Array) -> Array:
        """Return vectors of these lengths (C, T), parallel to ``v``."""
        scale = length / np.maximum(self.size(v), np.finfo(float).tiny)
        return (v.reshape(len(self.R), 2, -1) * scale[:, None]).reshape(v.shape)

    def force(self, v: Array) -> Array:
        """Return F(v)."""
        return self.scaled(v, self.factor * self.size(v) ** self.alpha)

    def velocity(self, force: Array) -> Array:
        """Return v with F(v) + Rv = ``force``."""
        return self.scaled(force, resolvent(self.size(force), self.R[:, None], self.factor, self.alpha))

    def point(self, v: Array, **values: Any) -> Point:
        """Return the values at one frequency, with the times of the contacts that move with ``v``."""
        square = (self.size(v) ** 2).mean(1)
        loss = self.factor * (self.size(v) ** (self.alpha + 1)).mean(1)
        tau = np.divide(loss, square, out=self.R.copy(), where=square > 0)
        return weighted_point(tau, square, **values)


def _periodic(
    respond: _Respond, law: _Law, wave: Field, rtol: float, most_iterations: int, comm: Comm
) -> tuple[Point, Field]:
    """Return the values at one frequency, and the harmonics (H,) of the strain.

    A fixed point of s: v is given by F(v) + Rv = √R s, and s ← s + √R(v′ − v), v′ the response to the forces Rv −
    F(v). ``wave`` (H, T) are the harmonics.
    """
    R = np.repeat(law.R, 2)[:, None]
    root = np.sqrt(R)

    def motion(force: Array) -> tuple[Array, _Motion]:
        found = respond(force @ wave.conj().T * 2 / wave.shape[1])
        return (found.velocity @ wave).real, found

    v, found = motion(np.zeros((len(R), wave.shape[1])))
    state = (law.force(v) + R * v) / root
    tried: list[Array] = []
    missed: list[Array] = []
    iterations, converged = 0, False
    while iterations < most_iterations and not converged:
        iterations += 1
        before = found.strain[0]
        v = law.velocity(root * state)
        moved, found = motion(2 * R * v - root * state)
        miss = root * (moved - v)
        mismatch = float(np.linalg.norm(miss) / np.linalg.norm(root * v))
        change = float(abs(before / found.strain[0] - 1))
        tried, missed = [*tried[1 - MEMORY :], state.ravel()], [*missed[1 - MEMORY :], miss.ravel()]
        state, converged = comm.bcast((mixed(tried, missed).reshape(v.shape), max(change, mismatch) < rtol))
    point = law.point(
        v,
        values=found.modulus,
        iterations=iterations,
        converged=converged,
        changes=change,
        tau_changes=mismatch,
        residuals=found.residual,
    )
    return comm.bcast((point, found.strain))


@contextmanager
def _responses(problem: LinearProblem, orders: Integers) -> Iterator[Callable[[float, float, Array], _Respond]]:
    """Yield, for ω, δσ and R (C,), the response to forces at contacts: a factor of K + inωAᵀRA for each harmonic n."""
    comm, mode, law = problem.comm, problem.strains[0], problem.law
    network, mine = problem.network, problem.ownership.owner == problem.comm.rank
    contacts = viscous_form(network, np.ones_like(mine), problem.strains, law)
    A, a = contacts.rows, contacts.strain_rows[:, 0]
    # with random R no entry is a sum that cancels, so the pattern has all entries
    pattern = viscous_form(network, mine, problem.strains, law, np.random.default_rng(0).uniform(1, 2, len(network)))
    dofs, area = problem.number(problem.active), problem.packing.box.area
    check_memory(comm, dofs.size * len(orders))  # the factors of all harmonics
    with ExitStack() as stack:
        parts = [
            (
                stack.enter_context(assembled(problem.K, pattern, dofs, comm)).A,
                stack.enter_context(direct_solver(comm, "petscjam_", definite=problem.definite)),
            )
            for _ in orders
        ]

        def prepare(omega: float, stress: float, R: Array) -> _Respond:
            B = viscous_form(network, mine, problem.strains, law, R)
            drive, columns = area * stress / np.sqrt(mode.scale), []  # in compression δp = 2G*s
            stiffness = problem.affine[0] + mode.pressure_term * problem.pressure * area / mode.scale
            with assembled(problem.K, pattern, dofs, comm, B) as pencil:
                for n, (matrix, solver) in zip(orders, parts, strict=True):
                    sum = pencil.combine(1, 0, 1j * n * omega)
                    sum.copy(matrix, structure=petsc().Mat.Structure.SAME_NONZERO_PATTERN)
                    solver.factor(matrix)
                    column = (pencil.k + 1j * n * omega * pencil.coupling[2])[:, 0]
                    follow, residual = solver.solve(column)
                    cell = stiffness + 1j * n * omega * np.repeat(R, 2) @ a**2 - total(comm, column @ follow)
                    columns.append((column, follow, cell, residual))

            def respond(forces: Field) -> _Motion:
                velocity, strain, worst = np.empty_like(forces), np.empty(len(orders), dtype=complex), 0.0
                loads = A.T @ forces
                for h, (n, (_, solver), (column, follow, cell, residual)) in enumerate(
                    zip(orders, parts, columns, strict=True)
                ):
                    x, found = solver.solve(dofs.scatter(loads[:, h].reshape(-1, 3), comm.rank))
                    push = a @ forces[:, h] + drive * (n == 1) - total(comm, column @ x)
                    strain[h] = push / cell
                    q = dofs.gather(x - follow * strain[h], comm)
                    velocity[:, h] = 1j * n * omega * contacts.relative(q, [strain[h]])
                    worst = max(worst, residual, found)
                return _Motion(velocity, strain, stress * np.sqrt(mode.scale) / strain[0], worst)

            return respond

        yield prepare
