"""The exact limits of the response, by direct solves.

ω → 0: u minimises the energy on the backbone; the motions without energy (θ, a rattler, the mean translation)
then minimise the dissipation. ω → ∞: u minimises the dissipation or, with inertia, is zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from petscjam.base.errors import SolverError
from petscjam.base.types import Array
from petscjam.geometry.network import rounded
from petscjam.parallel.comm import total
from petscjam.parallel.solver import DirectSolver, direct_solver
from petscjam.response.dofs import resists
from petscjam.response.matrices import Pencil, assembled
from petscjam.response.problem import LinearProblem
from petscjam.rows.kinematics import Field, Mask, Motion, displacements, translations

SOFT = 1e-8  # weight ε of friction, relative to the rate of a contact, for motions with stiffness
NO_FRICTION = 1e-12  # of the largest friction, below which a motion has none


class Limit(NamedTuple):
    """Storage modulus and viscosity at one end of the spectrum, with the residual of the solve."""

    G: float
    eta: float
    residual: float

    @classmethod
    def unknown(cls) -> Limit:
        """Return NaN for a limit that could not be computed."""
        return cls(np.nan, np.nan, np.nan)


def limit_or_note(solve: Callable[[], Limit], notes: list[str], what: str) -> Limit:
    """Solve for a limit; if that fails, return NaN and append the reason to ``notes``.

    Parameters
    ----------
    solve : callable
    notes : list of str
    what : str
        The limits, for the note.
    """
    try:
        return solve()
    except SolverError as error:
        notes.append(f"{what} could not be computed: {error}")
        return Limit.unknown()


def quasistatic(problem: LinearProblem) -> tuple[Field, float]:
    """Return the displacements (S, N, 3) that minimise the energy at unit strain, and the largest residual.

    Raises
    ------
    SolverError
        If K is singular on the pinned backbone.
    """
    if problem.zero_modes != 0:
        count = "an unknown number of" if problem.zero_modes is None else problem.zero_modes
        raise SolverError(f"K has {count} floppy modes on the backbone")
    dofs = problem.number(problem.pinned_backbone)
    fields, worst = [], 0.0
    with (
        assembled(problem.K_backbone, problem.B_backbone, dofs, problem.comm) as pencil,
        direct_solver(problem.comm, "petscjam_static_", definite=problem.definite) as solver,
    ):
        solver.factor(pencil.combine(1, 0))
        for forcing in pencil.k.T:
            x, residual = solver.solve(-forcing, "K is singular on the backbone (floppy motions)")
            fields.append(dofs.gather(x, problem.comm))
            worst = max(worst, residual)
    return np.array(fields), worst


def static_modulus(problem: LinearProblem) -> Limit:
    """Return G0 for the first strain mode, without η0."""
    fields, residual = quasistatic(problem)
    still: Motion = (fields[0], _unit(problem))
    return _limit(problem, problem.product(problem.K_backbone, still, still).real, np.nan, residual)


def zero_frequency(problem: LinearProblem) -> Limit:
    """Return G0, η0 for the first strain mode (docs/theory.md, Limits)."""
    fields, residual = quasistatic(problem)
    still: Motion = (fields[0], _unit(problem))
    if problem.pressed_rattlers:
        problem.notes.append("rattlers are pressed: not in mechanical equilibrium, η0 may be wrong")
    G0 = problem.product(problem.K_backbone, still, still).real
    moving, slack = relax_dissipation(problem, still)
    eta = problem.product(problem.B, moving, moving).real
    return _limit(problem, G0, eta, max(residual, slack))


def infinite_frequency(problem: LinearProblem, pencil: Pencil, solver: DirectSolver) -> Limit:
    """Return G∞, η∞: from the Schur complement of B, not B_γγ.

    With inertia the motion is affine in the limit: η∞V = B_γγ and G∞V = K_γγ − B_γu M⁻¹B_uγ.

    Parameters
    ----------
    problem : LinearProblem
    pencil : Pencil
        K and B, and M with inertia, on the unknowns.
    solver : DirectSolver
    """
    if problem.inertia:
        b, masses = pencil.b[:, 0], pencil.matrices[2].getDiagonal().array
        stored = total(problem.comm, float(np.sum(b**2 / masses.real)))
        return _limit(problem, problem.affine[0] - stored, problem.affine[1], 0.0)
    solver.factor(pencil.combine(0, 1))
    x, residual = solver.solve(-pencil.b[:, 0], "B is singular (motions without friction)")
    if singular(problem, pencil, solver):
        raise SolverError("B is singular: there are motions without friction")
    motion: Motion = (pencil.dofs.gather(x, problem.comm), _unit(problem))
    G = problem.product(problem.K, motion, motion).real
    eta = problem.product(problem.B, motion, motion).real
    return _limit(problem, G, eta, residual)


def singular(problem: LinearProblem, pencil: Pencil, solver: DirectSolver) -> bool:
    """Return whether x − B⁻¹(Bx) of a random motion x is a motion without friction.

    Parameters
    ----------
    problem, pencil
        As for :func:`infinite_frequency`.
    solver : DirectSolver
        With the factor of B.
    """
    x, y = pencil.vectors

    def resisted(motion: Field) -> tuple[Field, float]:
        x.array[:] = motion
        pencil.B.mult(x, y)
        force: Field = y.array.copy()
        return force, float(total(problem.comm, np.vdot(force, force).real)) ** 0.5

    field = np.random.default_rng(0).standard_normal((len(problem.packing), 3)).astype(complex)
    motion = pencil.dofs.scatter(field, problem.comm.rank)
    missed = solver.solve(resisted(motion)[0], largest=np.inf)[0] - motion
    size = total(problem.comm, np.vdot(missed, missed).real) ** 0.5
    return resisted(missed)[1] < NO_FRICTION * total(problem.comm, problem.B.diagonal()).max() * size


def relax_dissipation(problem: LinearProblem, motion: Motion) -> tuple[Motion, float]:
    """Add to a motion the motions without energy that minimise the dissipation.

    Parameters
    ----------
    problem : LinearProblem
    motion : (q, s)
        Displacements (N, 3) on the backbone and strains (S,).

    Returns
    -------
    motion : (q, s)
    residual : float
        The largest of the solves.
    """
    q, s = motion
    moves = [e for e in translations(len(problem.packing)) if resists(problem.B, e, problem.comm)]
    follow = problem.active & ~displacements(problem.backbone.backbone)
    starts: list[Motion] = [(q, s)]
    starts.extend(((e * problem.backbone.backbone[:, None]).astype(complex), np.zeros_like(s)) for e in moves)
    motions, residual = _follow(problem, follow, starts) if follow.any() else (starts, 0.0)
    (q, s), shifts = motions[0], motions[1:]
    if shifts:
        normal = [[problem.product(problem.B, a, b) for b in shifts] for a in shifts]
        drive = [problem.product(problem.B, a, (q, s)) for a in shifts]
        for amount, (shift, _) in zip(np.linalg.solve(normal, drive), shifts, strict=True):
            q = q - amount * shift
    return (q, s), residual


def _follow(problem: LinearProblem, follow: Mask, starts: list[Motion]) -> tuple[list[Motion], float]:
    """Solve for the degrees of freedom ``follow`` of each motion, the others given.

    They minimise K + εB. If they have no stiffness, the result does not depend on ε. A rattler that touches its
    neighbours minimises first the energy, then the dissipation: the limit ε → 0, extrapolated from ε and ε/2.
    """
    stiff = (total(problem.comm, problem.K.diagonal())[follow] > 0).any()
    soft = SOFT * problem.rate
    done, worst = _minimise(problem, follow, starts, soft)
    if stiff:
        half, residual = _minimise(problem, follow, starts, soft / 2)
        done = [(2 * q2 - q1, s) for (q1, s), (q2, _) in zip(done, half, strict=True)]
        worst = max(worst, residual)
    return done, worst


def _minimise(problem: LinearProblem, follow: Mask, starts: list[Motion], soft: float) -> tuple[list[Motion], float]:
    """Minimise K + ``soft``·B over the degrees of freedom ``follow``."""
    dofs = problem.number(follow)
    done, worst = [], 0.0
    with (
        assembled(problem.K, problem.B, dofs, problem.comm) as pencil,
        direct_solver(problem.comm, "petscjam_follow_", definite=problem.definite) as solver,
    ):
        solver.factor(pencil.combine(1, soft))
        for q, s in starts:
            force: Field = total(problem.comm, problem.K.apply(q, s) + soft * problem.B.apply(q, s))
            x, residual = solver.solve(
                -dofs.scatter(force, problem.comm.rank), "B is singular on the motions that K does not resist"
            )
            done.append((q + dofs.gather(x, problem.comm), s))
            worst = max(worst, residual)
    return done, worst


def _unit(problem: LinearProblem) -> Array:
    return np.eye(len(problem.strains))[0]


def _limit(problem: LinearProblem, energy: float, dissipation: float, residual: float) -> Limit:
    limits = problem.modulus(energy).real, problem.viscosity(dissipation)
    G, eta = rounded(limits, problem.rounding)
    return Limit(float(G), float(eta), residual)
