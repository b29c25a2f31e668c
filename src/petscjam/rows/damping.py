"""Viscous force laws, each as data: friction coefficients, and the point where the tangential velocity is taken.

A law is an entry of :data:`LAWS`, or an entry point ``petscjam.damping`` of another package; the command line, the
solver and the tests of laws use them. Its fields are its options, with their ``help`` as help texts.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import wraps
from importlib.metadata import EntryPoint
from inspect import signature
from typing import Any, ClassVar, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base import ranges
from petscjam.base.errors import InputError, shown
from petscjam.base.registry import Registry, loaded
from petscjam.geometry.network import ContactNetwork
from petscjam.rows.kinematics import Form, StrainMode, form

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class DampingLaw:
    """Friction coefficients, in units of kτ1, of the relative motions that a law resists.

    Attributes
    ----------
    name : str
    normal, tangential : float
        On Δu∥ and Δu⊥ of each contact.
    at_contact_point : bool
        Whether Δu⊥ is taken at the contact point (with rotations) or at the centres.
    body : float
        On the velocity of each disk relative to the affine flow.
    fluid : float
        Viscosity of the fluid between the disks, on the strain rate.
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

    @property
    def settings(self) -> dict[str, Any]:
        """Its fields by name."""
        return asdict(self)

    def __str__(self) -> str:
        return f"{self.name} ({', '.join(f'{name}={value}' for name, value in self.settings.items())})"


@dataclass(frozen=True)
class ContactDamping(DampingLaw):
    """Linear contact damping (BT eq. 5): kτ1 on Δu∥ and β kτ1 on Δu⊥.

    Parameters
    ----------
    beta : float
        Ratio β ≥ 0 of tangential to normal damping.
    rotations : bool
        Take Δu⊥ at the contact point, with rotations, or at the centres.
    """

    beta: float = field(default=1.0, metadata={"help": "tangential over normal damping"})
    rotations: bool = field(default=True, metadata={"help": "damp the velocities of the centres, without rotations"})
    name: ClassVar[str] = "contact"
    normal: ClassVar[float] = 1.0

    @property
    def tangential(self) -> float:
        """β."""
        return self.beta

    @property
    def at_contact_point(self) -> bool:
        """Whether rotations enter Δu⊥."""
        return self.rotations


@dataclass(frozen=True)
class StokesDrag(DampingLaw):
    """Stokes or mean-field drag (BT eqs. 7–8): kτ1 on the velocity of each disk relative to the affine flow.

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


@dataclass(frozen=True)
class StoredLaw(DampingLaw):
    """A law of another package as a file has it: its friction coefficients, without the package.

    Parameters
    ----------
    law : str
        Its name.
    numbers : tuple of (str, value)
        Its fields.
    friction : tuple of (str, float or bool)
        :data:`FRICTION`.
    """

    law: str
    numbers: tuple[tuple[str, Any], ...]
    friction: tuple[tuple[str, Any], ...]

    def __post_init__(self) -> None:
        for key, value in self.friction:
            if key not in FRICTION or not (isinstance(value, bool) or value in ranges.FRICTION):
                raise InputError(f"damping: {key} = {shown(value)} of the law {self.law!r}")
            object.__setattr__(self, f"_{key}", value)

    @classmethod
    def read(cls, law: str, said: str) -> StoredLaw:
        """Return the law of the text of :func:`as_stored`.

        Parameters
        ----------
        law, said : str

        Raises
        ------
        InputError
            If it is another text.
        """
        try:
            found = json.loads(said)
            return cls(law, tuple(found["numbers"].items()), tuple((key, found[key]) for key in FRICTION))
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(f"damping: {shown(said)} is not the friction of a law") from None

    @property
    def settings(self) -> dict[str, Any]:
        """Its fields."""
        return dict(self.numbers)

    def __getattribute__(self, key: str) -> Any:
        if key == "name":
            return self.law
        return super().__getattribute__(f"_{key}" if key in FRICTION else key)


def as_stored(law: DampingLaw) -> str:
    """Return the friction of a law of another package for a file, as JSON; empty for a law of petscjam."""
    if type(law).__module__.startswith("petscjam.") and not isinstance(law, StoredLaw):
        return ""
    return json.dumps({"numbers": law.settings, **{key: getattr(law, key) for key in FRICTION}})


def _law_of(point: EntryPoint) -> type[DampingLaw]:
    law = loaded(type)(point)
    if not issubclass(law, DampingLaw) or law.name != point.name:
        raise TypeError(f"it is not a DampingLaw with the name {point.name}")
    return law


FOREIGN = "friction"  # attribute of a law of another package in a file
FRICTION = ("normal", "tangential", "at_contact_point", "body", "fluid")
LAWS: Registry[type[DampingLaw]] = Registry(
    {law.name: law for law in (ContactDamping, StokesDrag)}, "petscjam.damping", _law_of
)


def law_or_default(damping: DampingLaw | str | None) -> DampingLaw:
    """Return ``damping``, or the law of this name; default: contact damping with β = 1 and rotations."""
    law = ContactDamping() if damping is None else damping
    if isinstance(law, str) and law in LAWS:
        return LAWS[law]()
    if not isinstance(law, DampingLaw):
        names = ", ".join(f'"{name}"' for name in LAWS)
        raise InputError(
            f"damping: {shown(law)} is not a law; write ContactDamping(beta=0.1), StokesDrag(…) or a name: {names}"
        )
    return law


def with_law(function: Callable[P, R]) -> Callable[P, R]:
    """Let ``function`` refuse the fields of a law as arguments: they are arguments of the law.

    Raises
    ------
    InputError
        It says what to write instead.
    """
    own = signature(function).parameters

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        unknown = kwargs.keys() - own.keys()
        for law in LAWS.values() if unknown else ():
            for name in unknown & {item.name for item in fields(law)}:
                where = "damping" if "damping" in own else "model"
                raise InputError(f"{name} belongs to the law: write {where}={law.__name__}({name}={kwargs[name]!r})")
        return function(*args, **kwargs)

    return checked


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
        Whether B contains the viscosity of the fluid, which only adds iωηF to G*.
    """
    weights = np.multiply.outer(np.broadcast_to(times, len(network)), [law.normal, law.tangential])
    eta = law.fluid if fluid else 0.0
    extra = np.diag([eta * network.area * mode.shears_fluid for mode in strains])
    return form(network, my_disks, strains, weights, at_contact_point=law.at_contact_point, body=law.body, extra=extra)
