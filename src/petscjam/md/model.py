"""The models of sheared disks: a damping law, how strong it is, and how large a time step it bears.

Units are those of VOT: the diameter ds of a small disk, the mass m and the time τe are 1, so ke is, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isfinite
from typing import Any

from petscjam.damping import LAWS, ContactDamping, DampingLaw
from petscjam.errors import InputError, shown

MODELS: dict[str, DampingLaw] = {
    "CD": ContactDamping(beta=1.0, rotations=False),  # VOT eq. 3
    "CD_rot": ContactDamping(beta=1.0, rotations=True),  # VOT eqs. 5–7
    "CD_n": ContactDamping(beta=0.0, rotations=False),  # VOT sec. II B, kd(t) = 0
}
# The largest rate of relaxation, in units of the friction coefficient of a contact, of a disk in the densest
# flow (measured, docs/design/0015), and the largest product of rate and time step of each integrator.
AT_CENTRES, AT_CONTACT_POINT = 7.7, 19.2
INTEGRATORS = {"heun": 2.0, "single": 1.0}
BULK = {"boundary": 0, "scale": 1, "profile": 2}  # what a change of the strain rate does to the disks
LARGEST_STEP = 0.2  # τe: the elastic forces, however weak the damping
STEP = 0.05  # τe, VOT sec. II D


@dataclass(frozen=True)
class Model:
    """What acts between disks: elastic repulsion (VOT eq. 2), damping of contacts, and perhaps a fluid.

    Parameters
    ----------
    law : DampingLaw
        The law of the linear response, with kτ1 = kd = 1/Q.
    Q : float
        Elasticity of collisions Q = m/(kd τe) > 0 (VOT eq. 9).
    exponent : float
        α ≥ 2 of the repulsion (VOT eq. 1).
    drag, spin_drag : float
        Stokes drag, in m/τe and m ds²/τe: −ζ(v − γ̇ y x̂) on a disk and −ζr(θ̇ + γ̇/2) on its rotation.

    Raises
    ------
    InputError
        If a number is not what it should be.
    """

    law: DampingLaw
    Q: float
    exponent: float = 2.0
    drag: float = 0.0
    spin_drag: float = 0.0

    def __post_init__(self) -> None:
        for name, value, good, what in (
            ("Q", self.Q, self.Q > 0, "above 0"),
            ("exponent", self.exponent, self.exponent >= 2, "at least 2"),
            ("drag", self.drag, self.drag >= 0, "0 or more"),
            ("spin_drag", self.spin_drag, self.spin_drag >= 0, "0 or more"),
        ):
            if not (good and isfinite(value)):
                raise InputError(f"shear: {name} must be {what} and finite, not {shown(value)}")
            object.__setattr__(self, name, float(value))

    @property
    def name(self) -> str:
        """Its name in VOT, or what the law says of itself."""
        return next((name for name, law in MODELS.items() if law == self.law), str(self.law))

    @property
    def normal(self) -> float:
        """Friction coefficient of the normal relative velocity, in m/τe."""
        return self.law.normal / self.Q

    @property
    def tangential(self) -> float:
        """Friction coefficient of the tangential relative velocity, in m/τe."""
        return self.law.tangential / self.Q

    @property
    def rolls(self) -> bool:
        """Whether the tangential velocity is taken at the contact point."""
        return self.law.at_contact_point

    @property
    def body(self) -> float:
        """Friction coefficient of a disk against the affine flow, in m/τe."""
        return self.law.body / self.Q + self.drag

    def largest_step(self, integrator: str) -> float:
        """Return the largest stable time step of ``integrator``, in τe."""
        tangential = (AT_CONTACT_POINT if self.rolls else AT_CENTRES) * self.tangential
        fastest = max(AT_CENTRES * self.normal, tangential) + max(self.body, 8 * self.spin_drag)
        return min(LARGEST_STEP, INTEGRATORS[integrator] / fastest if fastest else LARGEST_STEP)

    def step(self, dt: float | None, integrator: str) -> float:
        """Return ``dt``; left out, VOT's 0.05 τe, or two thirds of the largest stable one if that is less.

        Raises
        ------
        InputError
            If ``dt`` is not a number above 0, or not stable; if there is no such integrator.
        """
        if integrator not in INTEGRATORS:
            raise InputError(f"shear: no integrator {integrator!r}; there are {', '.join(INTEGRATORS)}")
        largest = self.largest_step(integrator)
        if dt is None:
            return min(STEP, 2 / 3 * largest)
        if not 0 < dt <= largest * (1 + 1e-12):
            raise InputError(
                f"shear: dt must be above 0 and, for {integrator} with {self.name} at Q = {self.Q:g}, "
                f"at most {largest:.3g} tau_e, not {shown(dt)}"
            )
        return float(dt)


def model(law: str | DampingLaw, Q: float, **others: Any) -> Model:
    """Return the model of a name of :data:`MODELS`, or of a damping law."""
    if isinstance(law, str):
        if law not in MODELS:
            raise InputError(f"shear: the model {law!r} is unknown; known are {', '.join(MODELS)}")
        law = MODELS[law]
    if not isinstance(law, tuple(LAWS.values())):
        raise InputError(f"shear: {shown(law)} is neither the name of a model nor a damping law")
    return Model(law, Q, **others)


def model_of(settings: Mapping[str, Any]) -> Model:
    """Return the model of a run from its settings."""
    law = MODELS.get(settings["model"])
    if law is None:
        kind = LAWS[settings["law"]]
        law = kind(**{item.name: settings[item.name] for item in fields(kind)})
    return Model(law, **{name: settings[name] for name in ("Q", "exponent", "drag", "spin_drag")})
