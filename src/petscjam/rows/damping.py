"""Viscous force laws, each as data: what they rub on, how hard, and where.

A law is an entry of :data:`LAWS`; the command line, the solver and every test of laws find it there. Its
fields are its options, and their ``help`` is what the command says of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base import ranges
from petscjam.base.errors import InputError, shown
from petscjam.geometry.network import ContactNetwork
from petscjam.rows.kinematics import Form, StrainMode, form


@dataclass(frozen=True)
class DampingLaw:
    """Friction coefficients, in units of kτ1, of the relative motions that a law resists.

    Attributes
    ----------
    name : str
    normal, tangential : float
        On Δu∥ and Δu⊥ of each contact.
    at_contact_point : bool
        Whether Δu⊥ is taken where the disks touch (they roll) or at their centres.
    body : float
        On the motion of each disk against the affine flow.
    fluid : float
        Viscosity of the fluid between, which the strain itself has to overcome.
    """

    name: ClassVar[str]
    normal: ClassVar[float] = 0.0
    body: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not isinstance(value, bool):
                ranges.FRICTION.check(f"damping: {item.name}", value)
                object.__setattr__(self, item.name, float(value))

    @property
    def tangential(self) -> float:
        """Coefficient of Δu⊥."""
        return 0.0

    @property
    def at_contact_point(self) -> bool:
        """Whether Δu⊥ is taken at the contact point."""
        return False

    @property
    def fluid(self) -> float:
        """Viscosity of the fluid."""
        return 0.0

    def __str__(self) -> str:
        settings = ", ".join(f"{item.name}={getattr(self, item.name)}" for item in fields(self))
        return f"{self.name} ({settings})"


@dataclass(frozen=True)
class ContactDamping(DampingLaw):
    """Linear contact damping (BT eq. 5): kτ1 on Δu∥ and β kτ1 on Δu⊥.

    Parameters
    ----------
    beta : float
        Ratio β ≥ 0 of tangential to normal damping.
    rotations : bool
        Take Δu⊥ where the disks touch and let them roll, or at their centres.
    """

    beta: float = field(default=1.0, metadata={"help": "tangential over normal damping"})
    rotations: bool = field(default=True, metadata={"help": "damp at the centres, disks do not roll"})
    name: ClassVar[str] = "contact"
    normal: ClassVar[float] = 1.0

    @property
    def tangential(self) -> float:
        """β."""
        return self.beta

    @property
    def at_contact_point(self) -> bool:
        """Whether the disks roll."""
        return self.rotations


@dataclass(frozen=True)
class StokesDrag(DampingLaw):
    """Stokes or mean-field drag (BT eqs. 7–8): kτ1 on each disk's motion against the affine flow.

    Parameters
    ----------
    eta_fluid : float
        Viscosity ηF ≥ 0 of the fluid, in units of kτ1 (in two dimensions).
    """

    eta_fluid: float = field(default=1.0, metadata={"help": "viscosity of the fluid, in k tau1"})
    name: ClassVar[str] = "stokes"
    body: ClassVar[float] = 1.0

    @property
    def fluid(self) -> float:
        """ηF."""
        return self.eta_fluid


LAWS: dict[str, type[DampingLaw]] = {law.name: law for law in (ContactDamping, StokesDrag)}


def law_or_default(damping: DampingLaw | None) -> DampingLaw:
    """Return ``damping``; left out, contact damping with β = 1 and rotations."""
    law = ContactDamping() if damping is None else damping
    if not isinstance(law, DampingLaw):
        raise InputError(f"damping: {shown(law)} is not a law; take ContactDamping(…) or StokesDrag(…)")
    return law


def viscous_form(
    network: ContactNetwork,
    my_disks: NDArray[np.bool_],
    strains: Sequence[StrainMode],
    law: DampingLaw,
    times: ArrayLike = 1.0,
    *,
    fluid: bool = True,
) -> Form:
    """Return B: twice the Rayleigh dissipation function of ``law`` (BT eqs. 6 and 8).

    Parameters
    ----------
    network, my_disks, strains
        As for :func:`petscjam.rows.kinematics.form`.
    law : DampingLaw
    times : float or (C,)
        Factor of the friction of each contact, in τ1.
    fluid : bool
        Whether B has the viscosity of the fluid: it adds iωηF to G*, and changes nothing else.
    """
    weights = np.multiply.outer(np.broadcast_to(times, len(network)), [law.normal, law.tangential])
    eta = law.fluid if fluid else 0.0
    extra = np.diag([eta * network.area * mode.shears_fluid for mode in strains])
    return form(network, my_disks, strains, weights, at_contact_point=law.at_contact_point, body=law.body, extra=extra)
