"""A packing, a law and strain modes, made ready for a communicator: the forms K and B and who owns what."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from petscjam.damping import DampingLaw, viscous_form
from petscjam.errors import InputError, SolverError
from petscjam.kinematics import Field, Form, Motion, StrainMode, elastic_form
from petscjam.network import ContactNetwork
from petscjam.packing.certify import modes, negative_modes
from petscjam.packing.packing import Certificate, Packing
from petscjam.parallel.comm import on_root, total
from petscjam.parallel.memory import give_back_memory
from petscjam.response.dofs import Dofs, Mask, Ownership, unknowns


class LinearProblem:
    """(K + iωB) Q = G*V e_γ for one packing, law and choice of pre-stress (BT eqs. 10–13).

    Rattlers are taken out, unless the law drags them along. ``affine`` is (K_γγ, B_γγ); ``notes`` say what
    could not be had, and why.

    Raises
    ------
    InputError
        If the packing has no contacts, or falls apart.
    """

    def __init__(
        self, packing: Packing, law: DampingLaw, strains: Sequence[StrainMode], prestress: bool, comm: Any
    ) -> None:
        self.packing, self.law, self.strains, self.comm = packing, law, tuple(strains), comm
        self.prestress = prestress
        self.notes: list[str] = []
        whole = ContactNetwork.of(packing)
        self.backbone = whole.without_rattlers()
        self.network = whole if law.body else self.backbone
        self.pressure = prestress * self.network.pressure
        self.ownership = Ownership.of(packing, comm.size)
        my_disks = self.ownership.owner == comm.rank

        def forms(network: ContactNetwork) -> tuple[Form, Form]:
            K = elastic_form(network, my_disks, strains, prestress=prestress)
            return K, viscous_form(network, my_disks, strains, law)

        self.K, self.B = forms(self.network)
        self.K_backbone, self.B_backbone = forms(self.backbone) if law.body else (self.K, self.B)
        self.active: Mask = unknowns(self.K, self.B, self.network, comm)
        self.pinned_backbone: Mask = self.backbone.backbone[:, None] & np.array([True, True, False])
        self.pinned_backbone[np.argmax(self.backbone.backbone)] = False
        rigid: Motion = (np.zeros((len(packing), 3), dtype=complex), np.eye(len(strains))[0])
        self.affine = (self.product(self.K, rigid, rigid).real, self.product(self.B, rigid, rigid).real)

    @property
    def rate(self) -> float:
        """Rate at which a contact relaxes by itself, 1/τ1: its mean stiffness over its friction kτ1."""
        return float(self.backbone.stiffness.mean())

    @cached_property
    def negative_modes(self) -> int | None:
        """Number of negative modes of K on the pinned backbone; None, with a note, if unknown.

        Without pre-stress K is a sum of squares. A certificate of this very packing says it, too; otherwise
        they are counted.
        """
        if not self.prestress or self._certified.negative_modes == 0:
            return 0
        return self._counted(negative_modes, "negative")

    @cached_property
    def floppy_modes(self) -> int | None:
        """Number of zero modes, the same way."""
        certified = self._certified
        if certified.negative_modes == certified.zero_modes == 0:
            return 0  # without pre-stress K is stiffer still
        return self._counted(lambda *which: modes(*which)[1], "zero")

    @property
    def _certified(self) -> Certificate:
        known = self.packing.certificate
        return known if known.checksum == self.packing.checksum else Certificate()

    def _counted(self, count: Callable[..., int], kind: str) -> int | None:
        try:
            counted = on_root(self.comm, count, self.backbone, self.prestress)
            give_back_memory()
            return counted
        except SolverError as error:
            self.notes.append(f"the {kind} modes could not be counted: {error}")
            return None

    @property
    def pressed_rattlers(self) -> bool:
        """Whether rattlers bear forces: the packing is not in equilibrium, and K is indefinite there."""
        return self.prestress and len(self.network) > len(self.backbone)

    @property
    def definite(self) -> bool:
        """Whether K is known to have no negative mode."""
        return self.negative_modes == 0 and not self.pressed_rattlers

    def number(self, active: Mask) -> Dofs:
        """Number the ``active`` (N, 3) degrees of freedom for this communicator."""
        return Dofs.number(active, self.ownership, self.comm.size)

    def product(self, form: Form, left: Motion, right: Motion) -> complex:
        """Return ⟨left, form right⟩, the left conjugated, summed over all ranks."""
        return complex(total(self.comm, form.product(left, right)))

    def displacement(self, q: Field) -> Field:
        """Return the displacements (N, 2) of ``q`` (N, 3), free of the choice of the disk that is held."""
        u = q[:, :2].copy()
        backbone = self.backbone.backbone
        if not self.law.body:
            u -= u[backbone].mean(0)
            u[~backbone] = np.nan
        return u

    def modulus(self, energy: complex) -> complex:
        """Turn A_eff of the first strain mode into its modulus."""
        mode = self.strains[0]
        return mode.scale * energy / self.packing.box.area + mode.pressure_term * self.pressure

    def viscosity(self, dissipation: float) -> float:
        """Turn Q†BQ of the first strain mode into its viscosity."""
        return self.strains[0].scale * dissipation / self.packing.box.area


def agree(comm: Any, packing: Packing, *settings: Any) -> None:
    """Refuse arguments that differ between ranks: those would wait for each other forever."""
    if len(set(comm.allgather((packing.checksum, *map(repr, settings))))) > 1:
        raise InputError("the arguments (packing, frequencies, law, …) differ between the ranks")


def describe(packing: Packing, network: ContactNetwork, name: str) -> dict[str, Any]:
    """Return what identifies ``packing`` in a result."""
    return {
        "name": name, "checksum": packing.checksum, "particles": len(packing), "phi": packing.phi,
        "diameter": packing.mean_diameter, "pressure": network.pressure, "Z": network.Z,
        "rattlers": network.rattlers, "potential": packing.potential_name,
    }  # fmt: skip
