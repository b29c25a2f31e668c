"""A packing, a law and strain modes on a communicator: the forms K and B and the distribution of unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import SolverError
from petscjam.base.types import Array, Integers
from petscjam.base.versions import __version__
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, on_root, total
from petscjam.parallel.memory import give_back_memory
from petscjam.parallel.petsc import petsc
from petscjam.preparation.certify import count_modes, dependent_rows
from petscjam.response.dofs import Dofs, Ownership, unknowns
from petscjam.response.origin import Origin
from petscjam.rows.damping import ContactDamping, DampingLaw, viscous_form
from petscjam.rows.inertia import inertia_form, masses_of
from petscjam.rows.kinematics import SIMPLE_SHEAR, Field, Form, Mask, Motion, StrainMode, displacements, elastic_form

NOT_BALANCED = "not in balance: net forces on disks reach {:.2g} p·d; petscjam import --relax balances them"


class LinearProblem:
    """(K + iωB) Q = G*V e_γ for one packing, law and choice of pre-stress (BT eqs. 10–13); −ω²M with inertia.

    Rattlers are removed, unless the law acts on each disk.

    Parameters
    ----------
    packing : Packing
    law : DampingLaw
    strains : sequence of StrainMode
    prestress : bool
        Keep the second term of BT eq. 4.
    comm : MPI communicator
    fluid : bool
        Whether B has the viscosity of the fluid.
    mass : float or (N,), optional
        Of the disks, in units of k τ1². Default: no inertia.

    Attributes
    ----------
    K, B : Form
        Of all contacts; K_backbone and B_backbone without those of rattlers.
    inertia : tuple of Form
        M, or none without inertia.
    masses : (N,) or None
    active : (N, 3) bool
        The unknown degrees of freedom without inertia.
    moving : (N, 3) bool
        Those with it: inertia resists every motion, so none is fixed.
    affine : (float, float)
        K_γγ and B_γγ of the first strain mode.
    notes : list of str
        Quantities that could not be computed, and the reasons.

    Raises
    ------
    InputError
        If the packing has no contacts, or is not connected.
    """

    def __init__(
        self,
        packing: Packing,
        law: DampingLaw,
        strains: Sequence[StrainMode],
        prestress: bool,
        comm: Comm,
        *,
        fluid: bool = True,
        mass: ArrayLike | None = None,
    ) -> None:
        self.packing, self.law, self.strains, self.comm = packing, law, tuple(strains), comm
        self.prestress = prestress
        self.notes: list[str] = []
        whole = ContactNetwork.of(packing)
        self.balanced, self.net_force = whole.balanced, whole.net_force
        if not self.balanced:
            self.notes.append(NOT_BALANCED.format(self.net_force))
        self.backbone = whole.without_rattlers()
        self.network = whole if law.body else self.backbone
        self.pressure = prestress * self.network.pressure
        self.ownership = Ownership.of(packing, comm.size)
        my_disks = self.ownership.owner == comm.rank

        def forms(network: ContactNetwork) -> tuple[Form, Form]:
            K = elastic_form(network, my_disks, strains, prestress=prestress)
            return K, viscous_form(network, my_disks, strains, law, fluid=fluid)

        self.K, self.B = forms(self.network)
        self.K_backbone, self.B_backbone = forms(self.backbone) if law.body else (self.K, self.B)
        resisted, self.active = unknowns(self.K, self.B, self.network, comm)
        if not (prestress or law.body) and self.zero_modes:
            self.active &= ~self._unresisted()
        self.masses = None if mass is None else masses_of(mass, len(packing))
        self.inertia: tuple[Form, ...] = ()
        self.moving: Mask = self.active
        if self.masses is not None:
            self.inertia = (inertia_form(self.masses, packing.radii, packing.mean_diameter, my_disks, strains),)
            self.moving = resisted
        self.pinned_backbone = displacements(self.backbone.backbone)
        self.pinned_backbone[np.argmax(self.backbone.backbone)] = False
        rigid: Motion = (np.zeros((len(packing), 3), dtype=complex), np.eye(len(strains))[0])
        self.affine = (self.product(self.K, rigid, rigid).real, self.product(self.B, rigid, rigid).real)

    @classmethod
    def elastic(cls, packing: Packing, prestress: bool, comm: Comm, *strains: StrainMode) -> LinearProblem:
        """Return a problem for K only.

        The contacts are those of the backbone; the law, contact damping, has no effect.

        Parameters
        ----------
        packing, prestress, comm
            As for the class.
        *strains : StrainMode
            Default: simple shear.
        """
        return cls(packing, ContactDamping(), strains or (SIMPLE_SHEAR,), prestress, comm)

    def coefficients(self, omega: float) -> tuple[complex, ...]:
        """Return those of K, B and, with inertia, M in K + iωB − ω²M."""
        return (1, 1j * omega, -(omega**2))[: 2 + len(self.inertia)]

    @property
    def rate(self) -> float:
        """Relaxation rate of a single contact, 1/τ1: mean stiffness over friction kτ1."""
        return float(self.backbone.stiffness.mean())

    @property
    def rounding(self) -> Array:
        """Largest modulus and viscosity that count as zero."""
        return self.network.rounding_modulus * np.array([1.0, 1 / self.rate])

    @property
    def negative_modes(self) -> int | None:
        """Number of negative modes of K on the pinned backbone; None, with a note, if unknown."""
        return 0 if not self.prestress else self._soft_modes[0]

    @property
    def zero_modes(self) -> int | None:
        """Number of zero modes, the same way."""
        return self._soft_modes[1]

    @cached_property
    def _soft_modes(self) -> tuple[int | None, int | None]:
        """Numbers of negative and of zero modes: from the certificate of this packing, or counted."""
        known = self.packing.certificate
        counts = known.negative_modes, known.zero_modes
        if known.checksum == self.packing.checksum and (counts == (0, 0) or (self.prestress and None not in counts)):
            return counts  # without pre-stress K is even stiffer
        try:
            return on_root(self.comm, count_modes, self.backbone, self.prestress)
        except SolverError as error:
            self.notes.append(f"the negative and zero modes could not be counted: {error}")
            return None, None
        finally:
            give_back_memory()

    def _unresisted(self) -> Mask:
        """Return degrees of freedom (N, 3) to fix: one for each motion that neither K nor B resists.

        For instance a cluster that does not touch its own images rotates and rolls as a whole. Both forms are
        sums of squares here, so a zero mode of K + B is a zero mode of each.
        """
        places = np.flatnonzero(self.active)

        def rows() -> Integers:
            everybody = np.ones(len(self.packing), dtype=bool)
            K = elastic_form(self.network, everybody, self.strains, prestress=False)
            B = viscous_form(self.network, everybody, self.strains, self.law)
            return dependent_rows(K.matrices(places)[0] / self.rate + B.matrices(places)[0])

        held = np.zeros(self.active.size, dtype=bool)
        held[places[on_root(self.comm, rows)]] = True
        return held.reshape(self.active.shape)

    @property
    def pressed_rattlers(self) -> bool:
        """Whether rattlers bear forces: the packing is not in equilibrium, and K is indefinite there."""
        return self.prestress and len(self.network) > len(self.backbone)

    @property
    def definite(self) -> bool:
        """Whether K certainly has no negative mode."""
        return self.negative_modes == 0 and not self.pressed_rattlers

    def number(self, active: Mask) -> Dofs:
        """Number the ``active`` (N, 3) degrees of freedom for this communicator."""
        return Dofs.number(active, self.ownership, self.comm.size)

    def product(self, form: Form, left: Motion, right: Motion) -> complex:
        """Return ⟨left, form right⟩, summed over all ranks.

        Parameters
        ----------
        form : Form
        left, right : (q, s)
            Displacements (N, 3) and strains (S,); ``left`` is conjugated.
        """
        return complex(total(self.comm, form.product(left, right)))

    def displacement(self, q: Field) -> Field:
        """Return the displacements (N, 2) of ``q`` (N, 3), independent of the choice of the fixed disk."""
        u = q[:, :2].copy()
        backbone = self.backbone.backbone
        if not self.law.body:
            u -= np.average(u[backbone], axis=0, weights=None if self.masses is None else self.masses[backbone])
            u[~backbone] = np.nan
        return u

    def modulus(self, energy: complex) -> complex:
        """Turn A_eff of the first strain mode into its modulus."""
        mode = self.strains[0]
        return mode.scale * energy / self.packing.box.area + mode.pressure_term * self.pressure

    def viscosity(self, dissipation: float) -> float:
        """Turn Q†BQ of the first strain mode into its viscosity."""
        return self.strains[0].scale * dissipation / self.packing.box.area


def describe(problem: LinearProblem, name: str, strain: str | None = None, damping: DampingLaw | None = None) -> Origin:
    """Return the origin of a result of ``problem``, with strain and law if the result depends on them.

    Parameters
    ----------
    problem : LinearProblem
    name : str
        Of the packing.
    strain : str, optional
        Name of the strain mode.
    damping : DampingLaw, optional
    """
    packing, network = problem.packing, problem.backbone
    return Origin(
        name=name,
        checksum=packing.checksum,
        particles=len(packing),
        phi=packing.phi,
        diameter=packing.mean_diameter,
        pressure=network.pressure,
        Z=network.Z,
        rattlers=network.rattlers,
        potential=packing.potential_name,
        balanced=problem.balanced,
        net_force=problem.net_force,
        strain=strain,
        damping=damping,
        prestress=problem.prestress,
        versions=f"petscjam {__version__}, PETSc {'.'.join(map(str, petsc().Sys.getVersion()))}",
    )
