"""One reduced model in (ω, β): contact damping at every β of a range (BT Fig. 4b).

B = (1 − β)B₀ + βB₁ with the friction matrices at β = 0 and 1, so three small matrices are sufficient for all β.

Axes: g point of the grid in (ω, β), m motion.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petscjam.base.errors import InputError
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.types import Array, per_decade
from petscjam.geometry.network import rounded
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve
from petscjam.parallel.memory import peak_memory
from petscjam.response.basis import ReducedBasis
from petscjam.response.limits import limit_or_note, zero_frequency
from petscjam.response.matrices import solving
from petscjam.response.problem import LinearProblem, describe
from petscjam.response.reduced import PLATEAU, checked_rtol, checked_span
from petscjam.response.spectrum import Spectrum, relaxed
from petscjam.rows.damping import ContactDamping, viscous_form
from petscjam.rows.kinematics import strain_mode

PER_DECADE = 4  # points of the grid in ω and β
MOST_NODES = 80
SOFT = 0.03  # frequency, relative to the rate of a contact, above which the response decreases
SAFETY = 10  # factor on the error from the ratios at the nodes
LARGEST_BETA = 1e3  # beyond it rounding errors dominate the residual


@dataclass(frozen=True, eq=False)
class Family:
    """G*(ω) at every β of a range: ``family(beta)`` is a :class:`Spectrum`.

    Its :meth:`Spectrum.error` is an estimate: the square of the residual, times ten times the largest ratio of
    true error to this square at the nodes. There is no estimate outside the span.

    Attributes
    ----------
    betas : (float, float)
        The range.
    factorisations : int
        For all β together.
    estimate : float
        Of |ΔG*|/|G*|, over the range and the span.
    G0 : (float, float)
        The limit of G* at ω → 0, from a direct solve if the span ends before its plateau, and the residual.
    rounding : (2,)
        Largest modulus and viscosity that count as zero.
    """

    betas: tuple[float, float]
    factorisations: int
    estimate: float
    base: Spectrum
    B0: Array
    B1: Array
    affine: tuple[float, float]
    rotations: bool
    G0: tuple[float, float]
    rounding: Array

    def __call__(self, beta: float) -> Spectrum:
        """Return the spectrum at ``beta``.

        Raises
        ------
        InputError
            If ``beta`` is outside the range.
        """
        low, high = self.betas
        if not low <= beta <= high:
            raise InputError(f"beta = {beta:g} is outside the range of the family, {low:g} to {high:g}")
        mixed = (1 - beta) * self.affine[0] + beta * self.affine[1]
        model = replace(
            self.base,
            B=(1 - beta) * self.B0 + beta * self.B1,
            affine=(self.base.affine[0], mixed),
            origin=replace(self.base.origin, damping=ContactDamping(beta, self.rotations)),
        )
        limits, limit_errors = model.own_limits()
        far = ~(limit_errors.max(1) < PLATEAU)
        limits[far], limit_errors[far] = np.nan, np.nan
        notes = model.notes
        if far.any():
            what = " and ".join(np.array(["η0", "G∞ and η∞"])[far])
            notes = (*notes, f"{what} lie beyond the span")
        if far[0]:
            limits[0, 0], limit_errors[0, 0] = self.G0
        limits = rounded(limits, self.rounding)
        return replace(model, limits=limits, limit_errors=limit_errors, notes=notes)


@reporting
def beta_family(
    packing: Packing,
    betas: tuple[float, float],
    span: tuple[float, float] = (1e-8, 1e2),
    *,
    rotations: bool = True,
    strain: str = "simple-shear",
    prestress: bool = True,
    rtol: float = 1e-6,
    comm: Comm | None = None,
    displacements: bool = True,
    name: str = "packing",
    progress: Progress | None = None,
    **solver_options: Any,
) -> Family:
    """Return G*(ω) under contact damping at every β between ``betas`` from one reduced model in (ω, β).

    Nodes are added where the residual is largest, each with q, ∂q/∂ω and ∂q/∂β, until the estimated error at the
    next node and the true error there are both below ``rtol``. All products are stored: 6 numbers for each
    unknown and motion.

    Parameters
    ----------
    packing : Packing
    betas : (float, float)
        Lowest and highest β, above 0, at most 1000.
    span, strain, prestress, rtol, comm, displacements, name, progress, **solver_options
        As for :func:`petscjam.spectrum`.
    rotations : bool
        As for :class:`ContactDamping`.

    Raises
    ------
    InputError, SolverError
        As :func:`petscjam.spectrum`; or if ``betas`` is not 0 < low < high.
    """
    comm, start = resolve(comm), time.perf_counter()
    agree(comm, packing, betas, span, rotations, strain, prestress, rtol, displacements, solver_options)
    for what, pair in (("betas", betas), ("span", span)):
        low, high = checked_span(pair, what)
        if low == high:
            raise InputError(f"{what}: must be 0 < low < high, not {low:g} twice")
    if betas[1] > LARGEST_BETA:
        raise InputError(f"betas: at most {LARGEST_BETA:g}, not {betas[1]:g}; above it make a spectrum for each")
    checked_rtol(rtol, 1e-10)
    mode = strain_mode(strain)
    problem = LinearProblem(packing, ContactDamping(1.0, rotations), [mode], prestress, comm)
    normal = viscous_form(problem.network, problem.ownership.owner == comm.rank, [mode], ContactDamping(0.0, rotations))
    rigid = (np.zeros((len(packing), 3), dtype=complex), np.ones(1))
    affine = problem.product(normal, rigid, rigid).real, problem.affine[1]
    with solving(problem, progress, normal, **solver_options) as (pencil, solver):
        basis = ReducedBasis(problem, pencil, solver)
        axes = [per_decade(PER_DECADE, *ends) for ends in (span, betas)]
        grid = np.array(np.meshgrid(*axes, indexing="ij")).reshape(2, -1).T
        nodes, estimate = _grow(basis, grid, rtol, progress)
        fields = basis.displacements() if displacements else None
        K, B1, B0 = basis.reduced
        performance = basis.performance(len(nodes))
        performance["peak_MB"] = comm.allgather(peak_memory())
        performance["seconds"] = comm.bcast(time.perf_counter() - start)
    if not estimate <= rtol:
        problem.notes.append(f"rtol = {rtol:g} is not met: the estimate is {estimate:.1e}")
    base = Spectrum(
        span=(float(span[0]), float(span[1])),
        rtol=rtol,
        K=K,
        B=B1,
        residual_K=np.zeros(len(K)),
        residual_B=np.zeros(len(K)),
        nodes=nodes[:, 0],
        gains=np.zeros(len(nodes), dtype=complex),
        gain_errors=np.zeros(len(nodes)),
        estimate=estimate,
        limits=np.full((2, 2), np.nan),
        limit_errors=np.full((2, 2), np.nan),
        forcing=(basis.norm(pencil.k), basis.norm(pencil.b)),
        affine=problem.affine,
        area=packing.box.area,
        pressure=problem.pressure,
        definite=False,
        negative_modes=problem.negative_modes,
        zero_modes=problem.zero_modes,
        origin=describe(problem, name, strain, problem.law),
        notes=tuple(problem.notes),
        performance=performance,
        motions=fields,
        geometry=packing if displacements else None,
    )
    low, high = betas
    family = Family(
        (float(low), float(high)),
        len(nodes),
        estimate,
        base,
        B0,
        B1,
        affine,
        rotations,
        (np.nan, np.nan),
        problem.rounding,
    )
    if comm.bcast(any(np.isnan(family(beta).G0) for beta in betas)):
        found = limit_or_note(lambda: zero_frequency(problem), problem.notes, "G0")
        family = replace(family, G0=(found.G, found.residual))
    return family


def _grow(basis: ReducedBasis, grid: Array, rtol: float, progress: Report | None) -> tuple[Array, float]:
    """Add nodes where the residual is largest until the error at a new one is below ``rtol``.

    This must hold at one node, and then again at one node in each third of the range of β. Return the nodes (F,
    2) and an estimate of the remaining error on the grid (:class:`Family`).
    """
    comm = basis.problem.comm
    residual = _Residual(basis)
    nodes = list(_corners(grid))
    for corner in nodes:
        residual.add(_vectors(basis, *corner))
    fresh = ~(grid[:, None] == np.array(nodes)).all(2).any(1)
    beta = np.log(grid[:, 1])
    third = np.minimum(3 * (beta - beta.min()) / np.ptp(beta), 2).astype(int)
    ratios: list[float] = []
    passed = 0
    while True:
        size = comm.bcast(residual.squared(grid))
        choice = np.flatnonzero(fresh & ((passed == 0) | (third == passed - 1)))
        if len(choice) == 0 or size.max() == 0:
            break
        here = choice[np.argmax(size[choice])]
        node, fresh[here] = grid[here], False
        expected = SAFETY * size[here] * max(ratios, default=np.inf)
        before = _energies(basis, node[None])[0][0]
        residual.add(_vectors(basis, *node))
        after = _energies(basis, node[None])[0][0]
        true = float(comm.bcast(abs(before / after - 1)))
        nodes.append(node)
        ratios += [true / size[here]] if size[here] > 0 else []
        if progress:
            done = np.log(np.clip(true, rtol / 10, 1)) / np.log(rtol)
            progress(float(np.clip(done, 0, 1)), f"{len(nodes)} factorisations, |G*| was within {true:.0e}")
        passed = passed + 1 if max(true, expected) <= rtol else 0
        if passed > third.max() + 1 or len(nodes) >= MOST_NODES:
            break
    left = SAFETY * comm.bcast(residual.squared(grid)).max() * max(ratios, default=0.0)
    return np.array(nodes), float(left)


def _corners(grid: Array) -> Array:
    low, high = grid.min(0), grid.max(0)
    return np.array([[w, beta] for w in (low[0], high[0]) for beta in (low[1], high[1])])


def _vectors(basis: ReducedBasis, omega: float, beta: float) -> list[Array]:
    """Factor at (ω, β) and return the new motions from q, ∂q/∂ω and ∂q/∂β."""
    pencil = basis.pencil
    _, B1, B0 = pencil.matrices
    k, b1, b0 = basis.coupling
    basis.solver.factor(pencil.combine(1, 1j * omega * beta, 1j * omega * (1 - beta)))
    q = basis.solve(-(k + 1j * omega * (beta * b1 + (1 - beta) * b0)))
    normal, tangential = b0 + basis.apply(B0, q), b1 + basis.apply(B1, q)
    by_omega = basis.solve(beta * tangential + (1 - beta) * normal)
    by_beta = basis.solve(tangential - normal)
    return [*basis.new_motions(q), by_omega.real, by_omega.imag, by_beta.real, by_beta.imag]


def _energies(basis: ReducedBasis, points: Array) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return G*V of the model at ``points`` (G, 2), and the motions (G, M)."""
    K, B1, B0 = basis.reduced
    omega, beta = points.T[:, :, None, None]
    A = K + 1j * omega * (beta * B1 + (1 - beta) * B0)
    Q = relaxed(A)
    return np.einsum("gm,gm->g", Q, A[:, :, 0]), Q


class _Residual:
    """‖r‖² anywhere in (ω, β), from the products of all forms with all motions."""

    def __init__(self, basis: ReducedBasis) -> None:
        self.basis = basis
        self.columns: list[NDArray[Any]] = []
        self.gram = np.zeros((0, 0))

    def add(self, vectors: list[Array]) -> None:
        """Extend the motions by ``vectors``."""
        basis = self.basis
        new = [] if self.columns else [force[:, None] for force in basis.forces]
        products = basis.extend(vectors)
        count = len(products) * products[0].shape[1]
        fresh = np.stack(products, axis=2).reshape(len(products[0]), count)  # forms of one motion
        fresh = np.hstack([*new, fresh])
        across = [basis.dot(block, fresh) for block in self.columns]
        own = basis.dot(fresh, fresh)
        across_all = np.vstack([np.zeros((0, fresh.shape[1])), *across])
        self.gram = np.block([[self.gram, across_all], [across_all.T, own]])
        self.columns.append(fresh)

    def squared(self, grid: Array) -> Array:
        """Return ‖r‖²/((1 + ω/SOFT)|G*V|) at ``grid`` (G, 2): about proportional to the error of G*."""
        energy, Q = _energies(self.basis, grid)
        omega, beta = grid.T
        c = np.stack([np.ones_like(omega), 1j * omega * beta, 1j * omega * (1 - beta)], axis=1)
        z = (Q[:, :, None] * c[:, None, :]).reshape(len(grid), -1)
        square = np.einsum("gi,gi->g", z.conj(), z @ self.gram).real.clip(0)
        return square / (1 + omega / (SOFT * self.basis.problem.rate)) / abs(energy)
