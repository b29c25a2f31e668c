"""Settings of a run. Units: ds, m, τe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.files import check_type
from petscjam.geometry.potential import power_law
from petscjam.md.model import Model

HISTORY = dict.fromkeys(("rate", "to", "kappa", "amplitude", "omega", "cycles"), "float")
HISTORY |= dict.fromkeys(("rates", "strains"), "Array")
MODEL = {"model": "str", "law": "str", "Q": "float", "potential": "str"}


class History(dict[str, Any]):
    """Settings of a strain history; a missing one is refused by name."""

    def __missing__(self, name: str) -> Any:
        raise InputError(f"settings: {name} is missing")


@dataclass(frozen=True, eq=False)
class Settings:
    """The settings of a run.

    Attributes
    ----------
    model : Model
    particles : int
    phi : float
        Packing fraction.
    protocol : str
        Name of the strain-rate history (:class:`petscjam.md.protocols.Protocol`).
    start : str
        Description of the initial state.
    strain0, time0 : float
        γ and time at the start.
    dt : float
        Time step in τe.
    integrator : str
    history : mapping
        Numbers of the protocol, as ``rate``, by name.
    bulk : str
        Effect of a change of the strain rate on the disks.
    row_steps : int
        Time steps of a row.
    seed : int or None
        Of a random start.
    angles : bool
        Whether the angles of the disks are kept.
    threads : int
    version, numba, processor : str
        Version, numba and processor: the last bits of the numbers may depend on them.
    """

    model: Model
    particles: int
    phi: float
    protocol: str
    start: str
    strain0: float
    time0: float
    dt: float
    integrator: str
    history: Mapping[str, Any] = field(default_factory=dict)
    bulk: str = "scale"
    row_steps: int = 1
    seed: int | None = None
    angles: bool = False
    threads: int = 1
    version: str | None = None
    numba: str | None = None
    processor: str | None = None

    @property
    def attributes(self) -> dict[str, Any]:
        """All of it by name, as in the file of the run."""
        own = {item.name: getattr(self, item.name) for item in fields(self) if item.name not in ("model", "history")}
        return {
            name: value for name, value in {**self.model.settings, **own, **self.history}.items() if value is not None
        }

    @classmethod
    def from_attributes(cls, attributes: Mapping[str, Any]) -> Settings:
        """Return the settings in the file of a run; files of schema 1 have an exponent for the potential.

        Raises
        ------
        InputError
            If something is missing or of the wrong type.
        """
        found = {name: v.item() if isinstance(v, np.generic) else v for name, v in attributes.items()}
        if "exponent" in found:
            found["potential"] = power_law(found.pop("exponent"), relative=True).name
        own = [item for item in fields(cls) if item.name not in ("model", "history")]
        for name in [*MODEL, *(item.name for item in own if item.default is MISSING)]:
            if name not in found:
                raise InputError(f"settings: {name} is missing")
        for name, annotation in {**MODEL, **{item.name: str(item.type) for item in own}}.items():
            check_type(f"settings: {name}", found.get(name), annotation)
        values = {item.name: found.pop(item.name) for item in own if item.name in found}
        model = Model.from_settings(found)
        history = History((k, v) for k, v in found.items() if k not in model.settings)
        for name in history.keys() & HISTORY.keys():
            check_type(f"settings: {name}", history[name], HISTORY[name])
            if not np.isfinite(history[name]).all():
                raise InputError(f"settings: {name} is not finite")
        return cls(model, **values, history=history)
