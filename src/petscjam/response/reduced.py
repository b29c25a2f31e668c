"""The reduced model of (K, B), and M with inertia: responses at a few frequencies.

They are chosen one by one until the error bound is below rtol.

Every rank has its rows of the motions, and the same small matrices between them (docs/theory.md, Reduced model).

Axes: n local rows, m motion (0 is Q₀, with strain 1), k node.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, SolverError, shown
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.types import Array, per_decade
from petscjam.geometry.network import rounded
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve, total
from petscjam.parallel.memory import check_memory, peak_memory
from petscjam.parallel.solver import DirectSolver, direct_solver
from petscjam.response.basis import NEW, ReducedBasis
from petscjam.response.dofs import free_motions, resists
from petscjam.response.inertial import InertialSpectrum
from petscjam.response.limits import infinite_frequency, limit_or_note, singular, zero_frequency
from petscjam.response.matrices import Pencil, assembled, solving
from petscjam.response.problem import LinearProblem, describe
from petscjam.response.spectrum import Spectrum
from petscjam.rows.damping import DampingLaw, law_or_default, with_law
from petscjam.rows.kinematics import strain_mode

PER_DECADE = 32  # frequencies at which the error bound is tested
EVERY = 4  # every 4th of them may become a node
ORDER = 2  # a node gives q and dq/dω; at the ends of the span q alone
MOST_NODES, MOST_RESONANT = 40, 120  # without and with inertia
MOST_SPOILED = 3  # largest number of times that rounding errors of the gains may raise the bound above rtol again
MOST_DECADES = 30
PLATEAU = 1e-3  # relative distance of a limit from the value at the end of the span, above which it is solved for
SILENT = 1e-11  # residual, relative to the forces of the affine motion, that counts as a rounding error
LISTEN = 2  # frequencies per decade at which rounding errors are measured
STEPS, FACTOR = (
    4,
    10.0,
)  # of the power method; largest underestimate of ‖A⁻¹‖, except with a probability of √n/FACTOR^(2 STEPS)

Complex = NDArray[np.complex128]


@reporting
@with_law
def spectrum(
    packing: Packing,
    span: tuple[float, float] = (1e-8, 1e2),
    *,
    damping: DampingLaw | str | None = None,
    strain: str = "simple-shear",
    prestress: bool = True,
    rtol: float = 1e-6,
    mass: ArrayLike | None = None,
    comm: Comm | None = None,
    displacements: bool = True,
    name: str = "packing",
    progress: Progress | None = None,
    **solver_options: Any,
) -> Spectrum:
    """Return G*(ω) at every frequency of ``span`` from a few factorisations, with a bound on its error.

    A Galerkin projection of (K, B) on the responses at a few frequencies. The next frequency is that of the
    largest bound, until the bound is below ``rtol`` everywhere (docs/theory.md, Reduced model). The result does
    not depend on the number of ranks.

    Parameters
    ----------
    packing : Packing
    span : (float, float)
        Lowest and highest angular frequency, 1/τ1.
    damping : DampingLaw
        Default: :class:`ContactDamping` with β = 1 and rotations.
    strain : str
        ``simple-shear``, ``pure-shear`` or ``compression`` (the complex bulk modulus).
    prestress : bool
        Keep the second term of BT eq. 4.
    rtol : float
        Of |ΔG*|/|G*|, between 1e-12 and 0.1. If rounding errors exceed it, there is a note.
    mass : float or (N,) array_like
        Of every disk, or of each one, in units of k τ1² (docs/theory.md, Inertia). The result is an
        :class:`petscjam.response.inertial.InertialSpectrum`. Default: no inertia.
    comm : MPI communicator
        Default: COMM_SELF. The result is the same on every rank.
    displacements : bool
        Store the motions, (M, N, 2) numbers on every rank, for :meth:`Spectrum.displacement`.
    name : str
        Stored with the result.
    progress : callable
        Called on every rank with a fraction and a text.
    **solver_options
        ``out_of_core`` and ``block_low_rank`` of :func:`petscjam.parallel.solver.direct_solver`.

    Raises
    ------
    InputError
        On a span that is not 0 < low ≤ high, an unknown strain, a packing without a connected backbone, a mass
        that is not > 0.
    SolverError
        If a solve fails, or with inertia friction does not resist every motion.
    """
    comm, start = resolve(comm), time.perf_counter()
    agree(comm, packing, span, damping, strain, prestress, rtol, displacements, solver_options, mass)
    low, high = checked_span(span)
    checked_rtol(rtol, 1e-12)
    law = law_or_default(damping)
    problem = LinearProblem(packing, law, [strain_mode(strain)], prestress, comm, fluid=False, mass=mass)
    with ExitStack() as held:
        pencil, solver = held.enter_context(solving(problem, progress, **solver_options))
        grow: _Growing
        if mass is None:
            grow = _Projection(problem, pencil, solver)
        else:
            grow = _InertialProjection(
                problem, pencil, solver, held.enter_context(_friction(problem, **solver_options))
            )
        make = partial(
            grow.model_class,
            span=(low, high),
            rtol=rtol,
            limits=np.full((2, 2), np.nan),
            limit_errors=np.full((2, 2), np.nan),
            forcing=grow.forcing,
            affine=problem.affine,
            area=packing.box.area,
            pressure=problem.pressure,
            definite=problem.definite or mass is not None,
            mass=problem.masses,
            negative_modes=problem.negative_modes,
            zero_modes=problem.zero_modes,
            origin=describe(problem, name, strain, law),
        )
        model = _until_bounded(grow, make, progress)
        limits, limit_errors = comm.bcast(_own_limits(model, problem.notes))
        if not limit_errors[1].max() < PLATEAU:
            found = limit_or_note(lambda: infinite_frequency(problem, pencil, solver), problem.notes, "G∞ and η∞")
            limits[1], limit_errors[1] = (found.G, found.eta + model.fluid), found.residual
        motions = grow.displacements() if displacements else None
        performance = grow.performance(len(grow.nodes))
    if not limit_errors[0].max() < PLATEAU:
        found = limit_or_note(lambda: zero_frequency(problem), problem.notes, "G0 and η0")
        limits[0], limit_errors[0] = (found.G, found.eta + model.fluid), found.residual
    elif problem.pressed_rattlers:
        problem.notes.append("rattlers are pressed: not in mechanical equilibrium, G0 and η0 are of the model")
    performance["peak_MB"] = comm.allgather(peak_memory())
    performance["seconds"] = comm.bcast(time.perf_counter() - start)
    return replace(
        model,
        limits=comm.bcast(rounded(limits, problem.rounding)),
        limit_errors=comm.bcast(limit_errors),
        notes=tuple(problem.notes),
        performance=performance,
        motions=motions,
        geometry=packing if displacements else None,
    )


def checked_span(span: tuple[float, float], what: str = "span") -> tuple[float, float]:
    """Return both ends of a span of frequencies.

    Parameters
    ----------
    span : (low, high)
        0 < low ≤ high, 1/τ1.
    what : str
        Name of the argument.

    Raises
    ------
    InputError
        If they are not such numbers, or too many decades apart.
    """
    try:
        low, high = (float(end) for end in span)
    except (TypeError, ValueError):
        raise InputError(f"{what}: must be two numbers, not {shown(span)}") from None
    if not 0 < low <= high < np.inf:
        raise InputError(f"{what}: must be 0 < low ≤ high, not {low:g} and {high:g}")
    if np.log10(high) - np.log10(low) > MOST_DECADES:
        raise InputError(f"{what}: at most {MOST_DECADES} decades, not from {low:g} to {high:g}")
    return low, high


def checked_rtol(rtol: float, least: float) -> None:
    """Refuse a relative tolerance out of range.

    Parameters
    ----------
    rtol : float
    least : float
        The lowest allowed; the largest is 0.1.

    Raises
    ------
    InputError
    """
    if not (isinstance(rtol, Real) and least <= rtol <= 0.1):
        raise InputError(f"rtol: must be between {least:g} and 0.1, not {shown(rtol)}")


def _own_limits(model: Spectrum, notes: list[str]) -> tuple[Array, Array]:
    try:
        return model.own_limits()
    except SolverError as error:
        notes.append(f"the relaxations could not be computed: {error}")
        return np.full((2, 2), np.nan), np.full((2, 2), np.nan)


def _until_bounded(grow: _Growing, make: partial[Spectrum], progress: Report | None) -> Spectrum:
    """Add nodes where the bound is largest until it is below ``rtol``, or cannot be; return the model."""
    (low, high), rtol, comm = make.keywords["span"], make.keywords["rtol"], grow.problem.comm
    grid = per_decade(PER_DECADE, low, high)
    every = grow.every
    candidates = grid[every:-every:every] if len(grid) > 2 * every else grid[1:-1]
    for omega in np.unique([low, high]):
        grow.add(omega, order=1)
    spoiled = 0
    while True:
        model = make(**comm.bcast(grow.model(grid)))
        peaks = comm.bcast(model.resonances())
        tested, free = np.append(grid, peaks), np.append(candidates, peaks)
        bound = comm.bcast(np.nan_to_num(model.truncation(tested), nan=np.inf))
        fresh = free[~np.isin(free, model.nodes)]
        last = len(fresh) == 0 or len(grow.nodes) >= grow.most or model.rounding_only
        if last or bound.max() <= rtol:
            spoiled += 1
            if not model.rounding_only:
                model = replace(model, gain_errors=comm.bcast(grow.gain_errors()))
            bound = comm.bcast(model.truncation(tested))
        worst = float(bound.max())
        if progress:
            done = np.clip(np.log(max(worst, rtol / 10)) / np.log(rtol), 0, 1) if worst < 1 else 0.0
            progress(float(done), f"{len(grow.nodes)} factorisations, |G*| within {worst:.0e}")
        if last or worst <= rtol or spoiled == MOST_SPOILED:
            break
        there = np.nan_to_num(model.truncation(fresh), nan=np.inf)
        grow.add(comm.bcast(float(fresh[np.argmax(there)])), order=ORDER)
    floor = float(model.error(tested).max())
    if not worst <= rtol:
        grow.problem.notes.append(f"rtol = {rtol:g} is not met: the error bound is {worst:.1e}")
    elif floor > rtol:
        grow.problem.notes.append(f"limited by rounding errors: the error bound is {floor:.1e}")
    return model


@dataclass(eq=False)
class _Node:
    """A frequency, the last vector t from its factor, and the forces Vᵀ(K + iωB)t."""

    omega: float
    order: int
    top: Complex
    forces: Complex


class _Growing(ReducedBasis, ABC):
    """Motions from nodes of one pencil, and the arrays of a model, with those of its error bound."""

    model_class: ClassVar[type[Spectrum]] = Spectrum
    every: ClassVar[int] = EVERY
    most: ClassVar[int] = MOST_NODES

    def __init__(self, problem: LinearProblem, pencil: Pencil, solver: DirectSolver) -> None:
        super().__init__(problem, pencil, solver)
        self.nodes: list[Any] = []
        self.forcing = self.norm(pencil.k), self.norm(pencil.b)

    @abstractmethod
    def add(self, omega: float, order: int) -> None:
        """Factor the pencil at ``omega``, and add q and its derivatives below ``order`` to the motions."""

    @abstractmethod
    def model(self, grid: Array) -> dict[str, Any]:
        """Return the arrays of a model."""

    @abstractmethod
    def gain_errors(self) -> Array:
        """Return the relative error of the gain of each node by rounding."""


class _Projection(_Growing):
    """Motions from nodes of one pencil (K, B), and the quantities of the error bound."""

    def __init__(self, problem: LinearProblem, pencil: Pencil, solver: DirectSolver) -> None:
        super().__init__(problem, pencil, solver)
        self.nodes: list[_Node] = []
        self._sizes = [
            np.sqrt(2 * abs(affine) * total(problem.comm, form.diagonal()).max())
            for affine, form in zip(problem.affine, pencil.forms, strict=True)
        ]

    def add(self, omega: float, order: int) -> None:
        """Factor K + iωB, and add q and its derivatives below ``order`` to the motions."""
        k, b = self.coupling
        self.solver.factor(self.pencil.combine(1, 1j * omega))
        q = self.solve(-(k + 1j * omega * b), drag=b)
        new = self.new_motions(q)
        forces = b + self.apply(self.pencil.B, q)
        top = self.solve(forces)
        for _ in range(order - 1):
            new += [top.real, top.imag]
            forces = self.apply(self.pencil.B, top)
            top = self.solve(forces)
        products = self.extend(new)
        for node in self.nodes:
            further = self.dot(products[0] + 1j * node.omega * products[1], node.top)
            node.forces = np.concatenate([node.forces, further])
        self.nodes.append(_Node(omega, order, top, self.on_motions(forces)))

    def model(self, grid: Array) -> dict[str, Any]:
        """Return the arrays of a :class:`Spectrum`: the pencil, the residual, the gains."""
        K, B = self.reduced
        common = {"K": K, "B": B, "nodes": np.array([node.omega for node in self.nodes])}
        R = self._direction(grid)
        if R is None:
            return common | self._rounding_only(grid)
        r = R.astype(complex)
        KR, BR = self.apply(self.pencil.K, r).real, self.apply(self.pencil.B, r).real
        residual_K = np.concatenate([[self.dot(R, self.forces[0])], self.on_motions(KR)])
        residual_B = np.concatenate([[self.dot(R, self.forces[1])], self.on_motions(BR)])
        gains = np.zeros(len(self.nodes), dtype=complex)
        for k, node in enumerate(self.nodes):
            y = self._correction(node)
            length = self.dot(KR + 1j * node.omega * BR, node.top)
            length = length + (residual_K + 1j * node.omega * residual_B)[1:] @ y
            gains[k] = self.dot(R, node.top) / length
        wrong = np.maximum(-gains.real, gains.imag).clip(0) * self.problem.definite  # with reliable signs
        with np.errstate(divide="ignore", invalid="ignore"):
            gain_errors = np.where(wrong > 0, wrong / abs(gains), 0.0)
        return common | {"residual_K": residual_K, "residual_B": residual_B, "gains": gains, "gain_errors": gain_errors}

    def _rounding_only(self, grid: Array) -> dict[str, Any]:
        """Return the arrays of a model whose residual is a rounding error of unknown direction.

        Its length is measured, relative to the forces of the affine motion; its gain at the last node is at most
        ‖A⁻¹‖, from a power method (docs/theory.md, Reduced model).
        """
        ratio = max(self.norm(self._residual(w)) / self._size(w) for w in grid[:: PER_DECADE // LISTEN])
        residual_K, residual_B = np.zeros((2, len(self.reduced[0])))
        residual_K[0], residual_B[0] = ratio * self._sizes[0], ratio * self._sizes[1]
        gains, gain_errors = np.zeros(len(self.nodes), dtype=complex), np.ones(len(self.nodes))
        gains[-1], gain_errors[-1] = self._largest_gain() * (1 - 1j), 0.0
        return {
            "residual_K": residual_K,
            "residual_B": residual_B,
            "gains": gains,
            "gain_errors": gain_errors,
            "rounding_only": True,
        }

    def _largest_gain(self) -> float:
        """Return an upper estimate of ‖A⁻¹‖, A = K + iω_kB of the last node.

        STEPS products with (A⁻¹)†A⁻¹ from a random vector give it within FACTOR (J. D. Dixon, SIAM J. Numer.
        Anal. 20, 812, 1983).
        """
        dofs, rank = self.pencil.dofs, self.problem.comm.rank
        start, stop = dofs.rows_of(rank)
        if dofs.size == 0:
            return 0.0
        parts = np.random.default_rng(0).standard_normal((2, dofs.size))[:, start:stop]
        x = parts[0] + 1j * parts[1]
        growth = -np.log(self.norm(x))
        for _ in range(STEPS):
            y, _ = self.solver.solve(x, largest=np.inf)
            x = self.solver.solve(y.conj(), largest=np.inf)[0].conj()  # A is symmetric
            growth += np.log(self.norm(x))
            x /= self.norm(x)
        return FACTOR * float(np.exp(growth / (2 * STEPS)))

    def gain_errors(self) -> Array:
        """Return for each node the fraction of its residual, or of the largest one, that is not along R: rounding."""
        errors = np.zeros(len(self.nodes))
        for k, node in enumerate(self.nodes):
            z = node.top + self.combine(self._correction(node))
            r = self.apply(self.pencil.K, z) + 1j * node.omega * self.apply(self.pencil.B, z)
            errors[k] = max(self._astray(r), self._off)
        return errors

    def _astray(self, r: Complex) -> float:
        """Return ‖r − R(Rᵀr)‖/‖r‖."""
        return self.norm(r - self._R * self.dot(self._R, r)) / self.norm(r)

    def _correction(self, node: _Node) -> Complex:
        """Return the Galerkin correction of ``node.top`` by the motions."""
        K, B = self.reduced
        A = K[1:, 1:] + 1j * node.omega * B[1:, 1:]
        return -np.linalg.solve(A, node.forces) if len(A) else np.zeros(0, dtype=complex)

    def _residual(self, omega: float) -> Complex:
        """Return the residual of the model at ``omega``, this rank's rows."""
        K, B = self.reduced
        A: Complex = K + 1j * omega * B
        y = -np.linalg.solve(A[1:, 1:], A[1:, 0]) if len(A) > 1 else np.zeros(0, dtype=complex)
        u = self.combine(y)
        r = self.forces[0] + self.apply(self.pencil.K, u)
        return r + 1j * omega * (self.forces[1] + self.apply(self.pencil.B, u))

    def _size(self, omega: float) -> float:
        """Return the size of the forces of the affine motion at ``omega`` without cancellation."""
        return float(np.hypot(self._sizes[0], omega * self._sizes[1])) or 1.0

    def _direction(self, grid: Array) -> Array | None:
        """Return R, the direction of the residual at every ω; None if the residual is a rounding error."""
        omega = self._loudest(grid)
        r = self._residual(omega)
        if not self.norm(r) > SILENT * self._size(omega):
            return None
        R = (r * np.exp(-0.5j * np.angle(self.dot(r, r)))).real
        R = self.outside(self.outside(R))
        self._R = R / self.norm(R)
        self._off = self._astray(r)
        return self._R

    def _loudest(self, grid: Array) -> float:
        """Return the frequency of the largest residual, from its zeros (nodes) and its poles (of the model)."""
        from scipy.linalg import eigvals

        K, B = self.reduced
        nodes = np.sort([node.omega for node in self.nodes])
        grid = np.concatenate([grid, np.sqrt(nodes[1:] * nodes[:-1])])
        with np.errstate(divide="ignore", invalid="ignore"):
            log = -np.log(np.hypot(self._sizes[0], grid * self._sizes[1]))
            for rate in eigvals(K[1:, 1:], B[1:, 1:]) if len(K) > 1 else ():
                if np.isfinite(rate):
                    log -= np.log(abs(rate + 1j * grid))
            for node in self.nodes:
                log += node.order * np.log(abs(grid**2 - node.omega**2))
        return float(self.problem.comm.bcast(grid[np.argmax(np.where(np.isfinite(log), log, -np.inf))]))


class _InertialProjection(_Growing):
    """Motions from nodes of (K, B, M), and the directions of the residual.

    The residual at any ω is in the span of K, B and M times the motions. At a node KQ is −iωBQ + ω²MQ, so K adds
    only what rounding leaves.

    Parameters
    ----------
    friction : DirectSolver
        With the factor of B, on the unknowns without inertia.
    """

    model_class = InertialSpectrum
    every = 1  # resonances are narrow
    most = MOST_RESONANT

    def __init__(self, problem: LinearProblem, pencil: Pencil, solver: DirectSolver, friction: DirectSolver) -> None:
        super().__init__(problem, pencil, solver)
        self._friction, self._directions = friction, np.empty((len(self.coupling[0]), 0))
        self._gain = np.empty((0, 0))
        self._parts: list[list[Array]] = [[], [], []]  # of K, B and M: products with blocks of motions
        rank = problem.comm.rank
        self._held = pencil.dofs.scatter(problem.active, rank)
        self._free = []
        for motion in free_motions(problem.network):
            e = pencil.dofs.scatter(motion * problem.moving, rank)
            Me = self.apply(pencil.matrices[2], e + 0j).real
            if not resists(problem.B, motion * problem.moving, problem.comm) and (eMe := float(self.dot(e, Me))):
                self._free.append((e, Me, eMe))  # without momentum, as nothing drives them

    def add(self, omega: float, order: int) -> None:
        """Factor K + iωB − ω²M, and add q and, for an ``order`` of 2, its derivative to the motions."""
        k, b, _ = self.coupling
        _, B, M = self.pencil.matrices
        self.solver.factor(self.pencil.combine(*self.problem.coefficients(omega)))
        q = self.solve(-(k + 1j * omega * b))
        first, new = not self.nodes, self.new_motions(q)
        if order > 1:
            slope = self.solve(b + self.apply(B, q) + 2j * omega * self.apply(M, q))
            new += [slope.real, slope.imag]
        products = self.extend(new)
        for part, force, product in zip(self._parts, self.forces, products, strict=True):
            part += [force[:, None]] * first + [product]
        fresh = [*self.forces[::-1]] * first + [v for product in products[::-1] for v in product.T]
        self._add_directions(fresh)
        self.nodes.append(omega)

    def _add_directions(self, vectors: list[Array]) -> None:
        """Add the part of ``vectors`` outside the directions to these, and B⁻¹ between all of them."""
        there = self._directions.shape[1]
        for vector in vectors:
            v, size = vector, self.norm(vector)
            for _ in range(2):
                v = v - self._directions @ self.dot(self._directions, v)
            if self.norm(v) > NEW * size:
                self._directions = np.column_stack([self._directions, v / self.norm(v)])
        solved = np.zeros_like(self._directions[:, there:])
        for column, direction in zip(solved.T, self._directions.T[there:], strict=True):
            x, residual = self._friction.solve(direction[self._held] + 0j, soft=True)
            column[self._held], self.residual = x.real, max(self.residual, residual)
        gain = self.dot(self._directions, solved)
        own = (gain[there:] + gain[there:].T) / 2
        self._gain = np.block([[self._gain, gain[:there]], [gain[:there].T, own]])

    def model(self, grid: Array) -> dict[str, Any]:
        """Return the arrays of an :class:`InertialSpectrum`."""
        K, B, M = self.reduced
        parts = [np.vstack([self.dot(block, self._directions) for block in part]) for part in self._parts]
        return {
            "K": K,
            "B": B,
            "M": M,
            "nodes": np.array(self.nodes),
            "gains": np.zeros(len(self.nodes), dtype=complex),
            "gain_errors": self.gain_errors(),
            "residual_K": parts[0],
            "residual_B": parts[1],
            "residual_M": parts[2],
            "friction": self._gain,
        }

    def gain_errors(self) -> Array:
        """Return zeros: the bound needs no gains at nodes."""
        return np.zeros(len(self.nodes))


@contextmanager
def _friction(problem: LinearProblem, **solver_options: Any) -> Iterator[DirectSolver]:
    """Yield a solver with the factor of B, on the unknowns without inertia.

    Parameters
    ----------
    problem : LinearProblem
    **solver_options
        As for :func:`spectrum`.

    Raises
    ------
    InputError
        If this factor and another one need more memory than is free.
    SolverError
        If friction does not resist every motion.
    """
    dofs = problem.number(problem.active)
    check_memory(problem.comm, 2 * dofs.size, out_of_core=bool(solver_options.get("out_of_core")))
    with (
        assembled(problem.K, problem.B, dofs, problem.comm) as pencil,
        direct_solver(problem.comm, "petscjam_friction_", definite=True, **solver_options) as solver,
    ):
        solver.factor(pencil.combine(0, 1))
        if singular(problem, pencil, solver):
            raise SolverError(
                "with inertia the reduced model has no error bound, as friction does not resist every motion"
            )
        yield solver
