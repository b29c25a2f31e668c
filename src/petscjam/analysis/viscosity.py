"""Viscosity and modulus at ω → 0, without other frequencies (BT eq. 22, Fig. 8)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from petscjam.base.progress import Progress, reporting
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve
from petscjam.response.limits import zero_frequency
from petscjam.response.origin import Judged, Verb, stored
from petscjam.response.problem import LinearProblem, describe
from petscjam.rows.damping import DampingLaw, law_or_default, with_law
from petscjam.rows.kinematics import strain_mode


@dataclass(frozen=True, eq=False)
class Viscosity(Judged):
    """η0 = lim G″/ω of one packing. Units: stress k (BT) or ke/d² (VOT), time τ1.

    Attributes
    ----------
    eta0, G0 : float
        Viscosity and modulus at ω → 0.
    residual : float
        Largest residual of the solves.
    """

    eta0: float = field(metadata=stored("stress*tau1"))
    G0: float = field(metadata=stored("stress"))
    residual: float
    settings: ClassVar[tuple[str, ...]] = ("strain", "damping")
    units: ClassVar[str] = "viscosity in k tau1, modulus in k"
    figure: ClassVar[str] = "petscjam.plots.viscosity:viscosity_figure"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        return {
            "law": str(self.damping),
            "eta0": self.eta0,
            "G0": self.G0,
            "residual": f"{self.residual:.0e}",
            "state": self.state,
        }


@reporting
@with_law
def viscosity(
    packing: Packing,
    *,
    damping: DampingLaw | str | None = None,
    prestress: bool = True,
    strain: str = "simple-shear",
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> Viscosity:
    """Return η0 = Q†BQ/V of the quasi-static motion (docs/theory.md, Limits).

    Parameters
    ----------
    packing, damping, prestress, strain, comm, name, progress
        As for :func:`petscjam.spectrum`.

    Raises
    ------
    InputError
        On an unknown strain, or a packing without a connected backbone.
    SolverError
        If K is singular on the backbone.
    """
    comm = resolve(comm)
    agree(comm, packing, damping, prestress, strain)
    law = law_or_default(damping)
    problem = LinearProblem(packing, law, [strain_mode(strain)], prestress, comm)
    low = zero_frequency(problem)
    if progress:
        progress(1.0, f"residual {low.residual:.0e}")
    return Viscosity(
        eta0=low.eta,
        G0=low.G,
        residual=low.residual,
        negative_modes=problem.negative_modes,
        zero_modes=problem.zero_modes,
        origin=describe(problem, name, strain, law),
        notes=tuple(problem.notes),
    )


VERB = Verb(viscosity, "eta0 and G0, one group for each packing and law")
