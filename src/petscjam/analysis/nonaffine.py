"""The quasi-static response: relative displacements at contacts and non-affine displacements (BT eqs. 4, 19–21).

Axes: c contact of the backbone, i disk of the backbone, x Cartesian.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from petscjam.base.progress import Progress, reporting
from petscjam.base.types import Array, Integers
from petscjam.geometry.network import rounded
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve
from petscjam.response.limits import quasistatic
from petscjam.response.origin import Judged, Verb, stored
from petscjam.response.problem import LinearProblem, describe
from petscjam.rows.kinematics import contact_rows, strain_mode

MOTIONS = ("parallel", "transverse", "nonaffine")


@dataclass(frozen=True, eq=False)
class QuasistaticResponse(Judged):
    """Motion at ω → 0 of one packing, per unit strain. Units: length d, stress k (BT) or ke/d² (VOT).

    Attributes
    ----------
    shear_modulus : float
        G0 (for ``compression`` the bulk modulus).
    parallel, transverse : (C,)
        Δu∥ and Δu⊥ of each contact at the centres, the affine motion included.
    nonaffine : (n, 2)
        u_na of each disk of the backbone; its mean is zero.
    stretching, pre_stress : float
        Σ k(Δu∥)²/V and −Σ (f/r)(Δu⊥)²/V, the two terms of BT eq. 4: they add up to G0 in simple shear.
    disks : (n,)
        Numbers of these disks in the packing.
    contacts : (C, 2)
        Disks of each contact.
    residual : float
        ‖Ku − f‖/‖f‖ of the solve.
    geometry : Packing
    """

    shear_modulus: float = field(metadata=stored("stress"))
    parallel: Array = field(metadata=stored("length per unit strain", "C", finite=True))
    transverse: Array = field(metadata=stored("length per unit strain", "C", finite=True))
    nonaffine: Array = field(metadata=stored("length per unit strain", "n 2", finite=True))
    stretching: float = field(metadata=stored("stress"))
    pre_stress: float = field(metadata=stored("stress"))
    disks: Integers = field(metadata=stored(axes="n"))
    contacts: Integers = field(metadata=stored(axes="C 2", parts=("i", "j")))
    residual: float
    geometry: Packing
    settings: ClassVar[tuple[str, ...]] = ("strain",)
    units: ClassVar[str] = "moduli in k, motions in d per unit strain"
    figure: ClassVar[str] = "petscjam.plots.nonaffine:nonaffine_figure"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        medians = {f"median {motion}": float(np.median(self.sizes(motion))) for motion in MOTIONS}
        means = {f"mean {motion}": float(self.sizes(motion).mean()) for motion in MOTIONS}
        return {
            "G0": self.shear_modulus,
            "stretching": self.stretching,
            "pre-stress term": self.pre_stress,
            **medians,
            **means,
            "residual": f"{self.residual:.0e}",
            "state": self.state,
        }

    @property
    def G0(self) -> float:
        """The same as ``shear_modulus``."""
        return self.shear_modulus

    def sizes(self, motion: str) -> Array:
        """Return |Δu∥| or |Δu⊥| of every contact or |u_na| of every disk: one of ``MOTIONS``."""
        values: Array = getattr(self, motion)
        return np.abs(values) if values.ndim == 1 else np.linalg.norm(values, axis=1)


@reporting
def quasistatic_response(
    packing: Packing,
    *,
    prestress: bool = True,
    strain: str = "simple-shear",
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> QuasistaticResponse:
    """Minimise the energy at unit strain: K u = −K_uγ on the backbone (BT, Relation to floppiness).

    Parameters
    ----------
    packing, prestress, strain, comm, name, progress
        As for :func:`petscjam.spectrum`.

    Raises
    ------
    InputError
        On an unknown strain, or a packing without a connected backbone.
    SolverError
        If K is singular on the backbone.
    """
    comm = resolve(comm)
    agree(comm, packing, prestress, strain)
    mode = strain_mode(strain)
    problem = LinearProblem.elastic(packing, prestress, comm, mode)
    (q,), residual = quasistatic(problem)
    network = problem.backbone
    rows, affine = contact_rows(network, [mode], at_contact_point=False)
    parallel, transverse = (rows @ q.real.ravel() + affine[:, 0]).reshape(-1, 2).T
    scale = mode.scale / packing.box.area
    stretching = scale * float(network.stiffness @ parallel**2)
    slack = -scale * prestress * float(network.force / network.distance @ transverse**2)
    curvature = scale * float(problem.K_backbone.extra[0, 0])
    if progress:
        progress(1.0, f"residual {residual:.0e}")
    modulus = stretching + slack + curvature + mode.pressure_term * problem.pressure
    modulus, stretching, slack = rounded([modulus, stretching, slack], problem.rounding[0]).tolist()
    return QuasistaticResponse(
        shear_modulus=modulus,
        parallel=parallel,
        transverse=transverse,
        nonaffine=problem.displacement(q)[network.backbone].real,
        stretching=stretching,
        pre_stress=slack,
        disks=np.flatnonzero(network.backbone),
        contacts=np.stack([network.i, network.j], axis=1),
        residual=residual,
        negative_modes=problem.negative_modes,
        zero_modes=problem.zero_modes,
        origin=describe(problem, name, strain),
        geometry=packing,
        notes=tuple(problem.notes),
    )


VERB = Verb(quasistatic_response, "relative displacements of every contact and non-affine motion of every disk")
