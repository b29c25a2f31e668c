"""Low modes: the softest motions of K, and the contribution of each to the quasi-static response.

Axes: m mode, i disk of the backbone, c contact of the backbone, x Cartesian.
"""

from __future__ import annotations

import time
from argparse import ArgumentParser
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import csr_array

from petscjam.base.arguments import Within, integer
from petscjam.base.errors import InputError
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.ranges import MODES
from petscjam.base.types import Array, Integers
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, on_root, resolve, total
from petscjam.parallel.eigen import EQUAL, Pairs, Search, lowest_pairs, search_all, settled
from petscjam.parallel.memory import check_memory
from petscjam.preparation.certify import EPS, below_all, hessian, pivots_below
from petscjam.response.dofs import Dofs
from petscjam.response.matrices import Pencil, assembled
from petscjam.response.origin import Result, Verb, stored
from petscjam.response.problem import LinearProblem, describe
from petscjam.rows.kinematics import contact_rows, displacements, strain_mode, translations

BELOW = 1e-6  # distance of the shift below zero, relative to the largest stiffness
LARGEST_DENSE, MANY = 5000, 0.1  # largest number of unknowns for LAPACK, if at least this fraction of modes is wanted
PROVED = {True: "proved", None: "not known"}
TIE = 1e-6  # relative difference up to which components are equally large
ZERO = 1e4 * EPS  # largest rounding error of an eigenvalue, relative to the largest stiffness


class QuasistaticParts(NamedTuple):
    """Δu∥ and Δu⊥ of each contact (C,) and u_na of each disk (n, 2), per unit strain."""

    parallel: Array
    transverse: Array
    nonaffine: Array


@dataclass(frozen=True, eq=False)
class Modes(Result):
    """The lowest modes of K on the backbone, translations left out. Units: stress k (BT) or ke/d² (VOT).

    Attributes
    ----------
    eigenvalues : (M,)
        λ, ascending; some are negative if the packing is not a minimum.
    vectors : (M, n, 2)
        Displacements, orthonormal; the largest component is positive. Those of equal eigenvalues depend only on
        the packing.
    residuals : (M,)
        ‖Kv − λv‖: K has an eigenvalue within this distance of λ.
    complete : bool or None
        True: a count of all eigenvalues below proves that none was missed; None if this is not proved; a note
        gives the reason.
    disks : (n,)
        Numbers of these disks in the packing.
    participation : (M,)
        (Σ|v_i|²)²/(n Σ|v_i|⁴): the fraction of disks that move.
    floppiness : (M,)
        √(Σ Δu⊥²/Σ Δu∥²) over contacts: large if contacts slide with little change of overlap.
    amplitudes : (M,)
        −(v·K_uγ)/λ, amplitude of the mode per unit strain at ω → 0. Zero for a mode at λ = 0.
    softening : (M,)
        (v·K_uγ)²/(λV), decrease of the modulus by the mode: G0 = ``G_affine`` − Σ softening over all modes.
    G_affine : float
        The modulus of the affine motion.
    geometry : Packing
    performance : dict
        Ranks, unknowns, eigensolves and counts, seconds.
    """

    eigenvalues: Array = field(metadata=stored("stress", "M", finite=True))
    vectors: Array = field(metadata=stored(axes="M n 2", finite=True))
    residuals: Array = field(metadata=stored("stress", "M"))
    complete: bool | None
    disks: Integers = field(metadata=stored(axes="n"))
    participation: Array = field(metadata=stored(axes="M", finite=True))
    floppiness: Array = field(metadata=stored(axes="M"))
    amplitudes: Array = field(metadata=stored(axes="M"))
    softening: Array = field(metadata=stored("stress", "M"))
    G_affine: float = field(metadata=stored("stress"))
    geometry: Packing
    performance: dict[str, Any] = field(default_factory=dict)
    settings: ClassVar[tuple[str, ...]] = ("strain",)
    units: ClassVar[str] = "eigenvalues and moduli in k"
    figure: ClassVar[str] = "petscjam.plots.modes:modes_figure"

    def row(self) -> dict[str, float | str]:
        """Return what the table shows of it."""
        return {
            "modes": f"{len(self.eigenvalues)}",
            "lowest": self.eigenvalues[0],
            "highest": self.eigenvalues[-1],
            "median floppiness": float(np.median(self.floppiness)),
            "median participation": float(np.median(self.participation)),
            "G_affine": self.G_affine,
            "softening": float(self.softening.sum()),
            "residual": f"{self.residuals.max():.0e}",
            "complete": PROVED.get(self.complete, "not known"),
        }

    @property
    def frequencies(self) -> Array:
        """√λ of disks of unit mass, (M,); −√|λ| if λ < 0."""
        return np.sign(self.eigenvalues) * np.sqrt(np.abs(self.eigenvalues))

    def response(self, m: int) -> QuasistaticParts:
        """Return the motion at ω → 0 of the affine deformation and the lowest ``m`` modes.

        Raises
        ------
        InputError
            If there are fewer modes.
        """
        known = len(self.eigenvalues)
        if not 0 <= m <= known:
            raise InputError(f"m: must be between 0 and {known}, the number of modes, not {m}")
        u = np.tensordot(self.amplitudes[:m], self.vectors[:m], axes=1)
        rows, affine = self._rows
        relative = (rows @ u.ravel() + affine).reshape(-1, 2)
        return QuasistaticParts(relative[:, 0], relative[:, 1], u)

    @cached_property
    def _rows(self) -> tuple[csr_array, Array]:
        return _rows(ContactNetwork.of(self.geometry).without_rattlers(), self.strain)


@reporting
def lowest_modes(
    packing: Packing,
    count: int = 50,
    *,
    prestress: bool = True,
    strain: str = "simple-shear",
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> Modes:
    """Return the ``count`` lowest modes of K on the backbone, and prove that none was missed.

    Shift and invert below the lowest eigenvalue, translations deflated. Then the pivots of one real LDLᵀ of
    K − σ, σ in a gap above the last mode, count the eigenvalues below σ (Sylvester). Missing modes, such as
    copies of a degenerate mode, are searched for with the known modes deflated, until the count agrees.

    ``count`` may cut a set of equal eigenvalues. The list is then the beginning of the list for a larger
    ``count``. Only if many more are equal (more than 64 and more than ``count``) not all are found; the list then
    has an arbitrary part of them, and there is a note.

    Parameters
    ----------
    count : int
        At least 1; at most 2n − 2 are returned, n the disks of the backbone.
    strain : str
        ``simple-shear``, ``pure-shear`` or ``compression``: the strain mode of ``amplitudes`` and ``softening``.
    packing, prestress, comm, name, progress
        As for :func:`petscjam.spectrum`.

    Raises
    ------
    InputError
        On a count below 1, an unknown strain, or a packing without a connected backbone.
    SolverError
        If the eigensolver fails, or does not find all modes.
    """
    comm, start = resolve(comm), time.perf_counter()
    agree(comm, packing, count, prestress, strain)
    mode = strain_mode(strain)
    problem = LinearProblem.elastic(packing, prestress, comm, mode)
    network = problem.backbone
    check(count, network)
    dofs = problem.number(displacements(network.backbone))
    needs = check_memory(comm, dofs.size)
    if progress:
        progress(0.0, needs)
    stiffest = float(total(comm, problem.K_backbone.diagonal()).max())
    with assembled(problem.K_backbone, problem.B_backbone, dofs, comm) as pencil:
        count = min(count, dofs.size - 2)
        if dofs.size <= LARGEST_DENSE and count > MANY * dofs.size:
            search = _dense(problem, pencil, count, ZERO * stiffest)
        else:
            search = _searched(problem, pencil, count, stiffest, progress)
        found = settled(pencil.K, None, search.pairs, count, probe(dofs, comm.rank), ZERO * stiffest)
        values, vectors = found.values, everywhere(problem, dofs, found.vectors)
        force = total(comm, found.vectors.T @ pencil.k[:, 0])
    sign = signs(vectors)
    vectors, force = vectors * sign[:, None], force * sign
    zero = abs(values) <= ZERO * stiffest
    if zero.any():
        problem.notes.append(f"modes at zero, left out of the response: {zero.sum()}")
    if negative := int((values < -ZERO * stiffest).sum()):
        problem.notes.append(f"not a minimum: {negative} negative modes among these")
    amplitudes = np.divide(-force, values, out=np.zeros_like(values), where=~zero)
    relative = (_rows(network, strain)[0] @ vectors.T).reshape(len(network), 2, -1)
    sliding, pressing = (relative[:, k] ** 2 for k in (1, 0))
    vectors = vectors.reshape(len(values), -1, 2)
    square = (vectors**2).sum(2)
    with np.errstate(divide="ignore"):
        floppiness = np.sqrt(sliding.sum(0) / pressing.sum(0))
    performance = {"ranks": comm.size, "unknowns": dofs.size, **search.performance}
    performance["seconds"] = time.perf_counter() - start
    return Modes(
        eigenvalues=values,
        vectors=vectors,
        residuals=found.residuals,
        complete=search.complete,
        disks=np.flatnonzero(network.backbone),
        participation=square.sum(1) ** 2 / (square.shape[1] * (square**2).sum(1)),
        floppiness=floppiness,
        amplitudes=amplitudes,
        softening=-mode.scale * amplitudes * force / packing.box.area,
        G_affine=problem.modulus(problem.affine[0]).real,
        origin=describe(problem, name, strain),
        geometry=packing,
        notes=(*problem.notes, *search.notes),
        performance=comm.bcast(performance),
    )


def check(count: int, network: ContactNetwork) -> None:
    """Refuse a ``count`` out of its range, and a backbone of one disk.

    Parameters
    ----------
    count : int
        Modes asked for.
    network : ContactNetwork

    Raises
    ------
    InputError
    """
    MODES.check("count:", count)
    if network.backbone.sum() < 2:
        raise InputError("packing: a backbone of one disk has only translations as modes")


def signs(vectors: Array) -> Array:
    """Return the sign of the largest component of each of ``vectors`` (M, 2n); if several are equal, of the first."""
    size = abs(vectors)
    largest = (size > (1 - TIE) * size.max(1, keepdims=True)).argmax(1)
    return np.sign(np.take_along_axis(vectors, largest[:, None], axis=1))[:, 0]


def everywhere(problem: LinearProblem, dofs: Dofs, columns: NDArray[Any]) -> Array:
    """Return the displacements of the backbone on every rank.

    Parameters
    ----------
    problem : LinearProblem
    dofs : Dofs
    columns : (n, M)
        This rank's rows.

    Returns
    -------
    (M, 2n)
    """
    backbone = problem.backbone.backbone
    gathered = [dofs.gather(column, problem.comm)[backbone, :2].real.ravel() for column in columns.T]
    return np.array(gathered)


def _rows(network: ContactNetwork, strain: str) -> tuple[csr_array, Array]:
    """Return the rows of Δu∥ and Δu⊥, alternating, over the displacements of the backbone, and those of the strain."""
    rows, affine = contact_rows(network, [strain_mode(strain)], at_contact_point=False)
    return rows[:, np.flatnonzero(displacements(network.backbone))], affine[:, 0]


def probe(dofs: Dofs, rank: int) -> Array:
    """Return a random number for each of this rank's unknowns, independent of the distribution over ranks.

    Parameters
    ----------
    dofs : Dofs
    rank : int

    Returns
    -------
    (n,)
        This rank's rows.
    """
    start, stop = dofs.rows_of(rank)
    return np.random.default_rng(0).standard_normal(dofs.index.size)[dofs.flat[start:stop]]


def _searched(problem: LinearProblem, pencil: Pencil, count: int, stiffest: float, progress: Report | None) -> Search:
    """Search until a count shows that no mode is missing."""
    comm, size, network = problem.comm, pencil.dofs.size, problem.backbone
    shift = -BELOW * stiffest
    if problem.negative_modes != 0:
        shift = on_root(comm, lambda: below_all(hessian(network, problem.prestress)))
    rigid = [pencil.dofs.scatter(e, comm.rank) * (size / 2) ** -0.5 for e in translations(len(problem.packing))]

    def search(wanted: int, known: Array | None) -> Pairs:
        return lowest_pairs(pencil.K, wanted, shift, leave_out=rigid, known=known)

    def count_below(sigma: float, room: float) -> int:
        return pivots_below(hessian(network, problem.prestress), sigma, room)

    return search_all(
        search,
        count_below,
        count,
        size - 2,
        comm,
        least=lambda _: ZERO * stiffest,
        left_out=(0.0, 0.0),
        progress=progress,
    )


def _dense(problem: LinearProblem, pencil: Pencil, count: int, least: float) -> Search:
    """Return the lowest modes, by LAPACK on one rank; the translations are shifted above all modes."""
    comm, backbone = problem.comm, problem.backbone.backbone

    def solve() -> tuple[Array, Array, Array]:
        K = hessian(problem.backbone, problem.prestress)
        rigid = np.tile(np.eye(2), (int(backbone.sum()), 1)) / np.sqrt(backbone.sum())
        above = 2 * abs(K).sum(0).max()
        values, vectors = eigh(K.toarray() + above * rigid @ rigid.T)
        last = values[count - 1]
        some = values <= last + max(EQUAL * abs(last), least)
        values, vectors = values[some], vectors[:, some]
        return values, vectors, np.linalg.norm(K @ vectors - vectors * values, axis=0)

    start = time.perf_counter()
    values, vectors, residuals = on_root(comm, solve)
    field = np.zeros((len(backbone), 3))
    local = np.empty((pencil.dofs.counts[comm.rank], len(values)))
    for m in range(len(values)):
        field[backbone, :2] = vectors[:, m].reshape(-1, 2)
        local[:, m] = pencil.dofs.scatter(field, comm.rank)
    performance = {"eigensolves": 1, "eigensolve_seconds": time.perf_counter() - start, "count_seconds": 0.0}
    return Search(Pairs(values, local, residuals), True, [], performance)


def _options(parser: ArgumentParser) -> None:
    count, other = Within(integer, MODES), "petscjam.response.relaxations:relaxation_modes"
    parser.add_argument("--count", type=count, default=50, metavar="M", help="how many (default 50)")
    text = "slowest relaxations under a damping law, instead of the modes of lowest frequency"
    parser.add_argument("--relaxation", dest="analyse", action="store_const", const=other, help=text)


VERB = Verb(lowest_modes, "eigenvalues in k (or times in tau1), vectors, residuals", _options, laws="--relaxation")
