"""The models of sheared disks: repulsion, damping law and its strength, and time step.

Units are those of VOT: the diameter ds of a small disk, the mass m and the time τe are 1, so ke is, too. Disks have
this mass unless the model has another one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf, sqrt
from typing import Any

from petscjam.base import ranges
from petscjam.base.errors import InputError, shown
from petscjam.geometry.potential import POTENTIALS, Potential, potential
from petscjam.rows.damping import FOREIGN, LAWS, ContactDamping, DampingLaw, StoredLaw, as_stored

MODELS: dict[str, DampingLaw] = {
    "CD": ContactDamping(beta=1.0, rotations=False),  # VOT eq. 3
    "CD_rot": ContactDamping(beta=1.0, rotations=True),  # VOT eqs. 5–7
    "CD_n": ContactDamping(beta=0.0, rotations=False),  # VOT sec. II B, kd(t) = 0
}
INTEGRATORS = {"heun": 2.0, "single": 1.0}  # the largest stable product of a rate of relaxation and dt
BULK = {"boundary": 0, "scale": 1, "profile": 2}  # effect of a change of the strain rate on the disks
LARGEST_STEP = 0.2  # τe for a mass of 1: a collision of two disks of diameter ds lasts 2.2 τe
STEP = 0.05  # τe for a mass of 1, VOT sec. II D
# The largest products of dt and the relaxation rates of two touching disks, normal and tangential, with an error
# of the energy budget below 1 % of the heat (measured, docs/design/0015).
ACCURATE = {"heun": (0.12, 0.25), "single": (0.12, 0.2)}
# Names in the file of a run, and of the fields.
STORED = {"drag": "stokes_drag", "spin_drag": "rotational_drag", "mass": "mass"}
STORED |= {name: name for name in ("drag_exponent", "drag_speed", "drag_cutoff")}


@dataclass(frozen=True)
class Model:
    """The forces on disks: elastic repulsion (VOT eq. 2), damping of contacts, and drag of a fluid.

    Parameters
    ----------
    law : DampingLaw
        The law of the linear response, with kτ1 = kd = 1/Q.
    Q : float
        Elasticity of collisions Q = m/(kd τe) > 0 of disks with a mass of 1 (VOT eq. 9).
    potential : Potential
        Of the repulsion, in units in which its energy scale is 1 for disks of diameter ds (VOT eq. 1).
    stokes_drag, rotational_drag : float
        Stokes drag, in m/τe and m ds²/τe: −ζ(v − γ̇ y x̂) on a disk and −ζr(θ̇ + γ̇/2) on its rotation.
    mass : float
        Of every disk, in m; its moment of inertia is mass R²/2.
    drag_exponent : float
        α of nonlinear drag of contacts: the friction is multiplied by [(v² + ε²)/w²]^((α − 1)/2), where v is the
        relative velocity at which the law acts, normal and tangential part together (BT eq. 9 with w = ρ0/τ1).
    drag_speed, drag_cutoff : float
        w and ε, in ds/τe.

    Raises
    ------
    InputError
        If a number is out of its range, or drag that the law does not have is nonlinear.
    """

    law: DampingLaw
    Q: float
    potential: Potential = POTENTIALS["harmonic-relative"]
    stokes_drag: float = 0.0
    rotational_drag: float = 0.0
    mass: float = 1.0
    drag_exponent: float = 1.0
    drag_speed: float = 1.0
    drag_cutoff: float = 0.0

    def __post_init__(self) -> None:
        for name, value, known in (
            ("Q", self.Q, ranges.Q),
            ("stokes_drag", self.stokes_drag, ranges.DRAG),
            ("rotational_drag", self.rotational_drag, ranges.DRAG),
            ("mass", self.mass, ranges.MASS),
            ("drag_exponent", self.drag_exponent, ranges.THINNING),
            ("drag_speed", self.drag_speed, ranges.SPEED),
            ("drag_cutoff", self.drag_cutoff, ranges.SPEED if self.drag_exponent != 1 else ranges.DRAG),
        ):
            known.check(f"shear: {name}", value)
            object.__setattr__(self, name, float(value))
        if self.drag_exponent != 1 and not (self.normal or self.tangential):
            raise InputError(f"shear: drag_exponent = {self.drag_exponent:g}, but {self.law} has no drag of contacts")

    @classmethod
    def of(cls, law: str | DampingLaw, Q: float, **others: Any) -> Model:
        """Return the model of a name of :data:`MODELS` or of ``LAWS``, or of a damping law.

        Parameters
        ----------
        law : str or DampingLaw
        Q : float
        **others
            Further fields.

        Raises
        ------
        InputError
            If the name is unknown, or the law is none of :data:`petscjam.rows.damping.LAWS`.
        """
        if isinstance(law, str):
            if law not in MODELS and law not in LAWS:
                raise InputError(f"shear: the model {law!r} is unknown; known are {', '.join([*MODELS, *LAWS])}")
            law = MODELS[law] if law in MODELS else LAWS[law]()
        if not isinstance(law, (StoredLaw, *LAWS.values())):
            raise InputError(f"shear: {shown(law)} is neither the name of a model nor a damping law")
        return cls(law, Q, **others)

    @property
    def settings(self) -> dict[str, Any]:
        """Its numbers by name, as in the file of a run."""
        numbers = {"Q": self.Q, "potential": self.potential.name}
        numbers |= {name: getattr(self, item) for name, item in STORED.items()}
        stored = as_stored(self.law)
        numbers |= {FOREIGN: stored} if stored else {}
        return {"model": self.name, "law": self.law.name, **self.law.settings, **numbers}

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Model:
        """Return the model of :attr:`settings`.

        Raises
        ------
        InputError
            If its law or its potential is unknown.
        """
        law = MODELS.get(settings["model"])
        if law is None:
            kind = LAWS.get(settings["law"])
            if kind is None and FOREIGN in settings:
                law = StoredLaw.read(settings["law"], settings[FOREIGN])
            elif kind is None:
                raise InputError(f"settings: the law {settings['law']!r} is unknown; known are {', '.join(LAWS)}")
            else:
                law = kind(**{item.name: settings[item.name] for item in fields(kind)})
        others = {item: settings[name] for name, item in STORED.items() if name in settings}
        return cls(law, settings["Q"], potential(settings["potential"]), **others)

    @property
    def name(self) -> str:
        """Its name in VOT, or the text of the law."""
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
    def film(self) -> tuple[float, float, float] | None:
        """Numbers of nonlinear drag (:func:`petscjam.md.contact.contact`); None: it is linear."""
        if self.drag_exponent == 1:
            return None
        return (self.drag_exponent - 1) / 2, self.drag_speed**-2, (self.drag_cutoff / self.drag_speed) ** 2

    @property
    def rolls(self) -> bool:
        """Whether the tangential velocity is taken at the contact point."""
        return self.law.at_contact_point

    @property
    def body(self) -> float:
        """Friction coefficient of a disk relative to the affine flow, in m/τe."""
        return self.law.body / self.Q + self.stokes_drag

    @property
    def fluid(self) -> float:
        """Viscosity of the fluid between the disks, in m/τe."""
        return self.law.fluid / self.Q

    def largest_step(self, integrator: str) -> float:
        """Return the largest time step, in τe, that is stable for pairs of touching disks.

        With more contacts the limit is computed during the run (:meth:`petscjam.md.simulation.Simulation.demand`).
        """
        normal, tangential = self._pair
        fastest = max(normal, tangential) + max(self.body, 8 * self.rotational_drag) / self.mass
        largest = LARGEST_STEP * sqrt(self.mass)
        return min(largest, INTEGRATORS[integrator] / fastest if fastest else largest)

    @property
    def _pair(self) -> tuple[float, float]:
        """Rates of relaxation of the normal and the tangential velocity of two disks that touch."""
        most = 1.0 if self.film is None else self.film[2] ** self.film[0]
        return 2 * most * self.normal / self.mass, (6 if self.rolls else 2) * most * self.tangential / self.mass

    def step(self, dt: float | None, integrator: str) -> float:
        """Return the time step, checked.

        Parameters
        ----------
        dt : float or None
            τe; None: one that keeps the energy budget within 1 %, at most VOT's 0.05 τe for a mass of 1.
        integrator : str
            A name from ``INTEGRATORS``.

        Raises
        ------
        InputError
            If ``dt`` is not a number above 0, or not stable for two disks; if there is no such integrator.
        """
        if integrator not in INTEGRATORS:
            raise InputError(f"shear: no integrator {integrator!r}; there are {', '.join(INTEGRATORS)}")
        largest = self.largest_step(integrator)
        if dt is None:
            accurate = (x / rate for x, rate in zip(ACCURATE[integrator], self._pair, strict=True) if rate)
            return min(STEP * sqrt(self.mass), largest / 2, *accurate)
        ranges.DT.check("shear: dt", dt)
        if not dt <= largest * (1 + 1e-12):
            raise InputError(
                f"shear: dt must be above 0 and, for {integrator} with {self.name} at Q = {self.Q:g}"
                f"{f' and a mass of {self.mass:g}' * (self.mass != 1)}, at most {largest:.3g} tau_e, not {shown(dt)}"
            )
        return float(dt)


def stable_step(integrator: str, relaxation: float, oscillation: float) -> float:
    """Return the largest stable time step, in τe (docs/theory.md, Largest time steps).

    Parameters
    ----------
    integrator : str
        A name from ``INTEGRATORS``.
    relaxation, oscillation : float
        Largest eigenvalues of M⁻¹B, 1/τe, and M⁻¹K, 1/τe².
    """
    if integrator == "heun":
        return min(2 / relaxation if relaxation else inf, sqrt(3 / oscillation) if oscillation else inf)
    both = relaxation + sqrt(relaxation**2 + oscillation)
    return 2 / both if both else inf
