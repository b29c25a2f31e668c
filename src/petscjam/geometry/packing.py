"""A packing: disks in a periodic cell, and its certificate.

Axes: i disk, x Cartesian.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from hashlib import sha256
from os import PathLike
from typing import Any

import numpy as np

from petscjam.base.errors import InputError, shown
from petscjam.base.files import check_shapes, check_type
from petscjam.base.tables import Table, Tabular
from petscjam.base.types import Array, frozen
from petscjam.geometry import packing_file
from petscjam.geometry.box import Box
from petscjam.geometry.potential import Potential, potential


@dataclass(frozen=True)
class Certificate:
    """The measured quantities of a packing (:func:`petscjam.certify`). ``None`` means "not measured".

    Attributes
    ----------
    max_force : float
        Largest residual force on a disk, relative to p·d (p pressure, d mean diameter).
    pressure_error : float
        |p − target| / target; ``None`` when no target is known.
    stress_error : float
        Largest part of σ − p·1, relative to p: the residual shear stress.
    rattlers : int
        Disks with fewer than three contacts, removed repeatedly until none is left.
    contacts : int
        Contacts inside the backbone.
    Z : float
        Mean number of contacts of a disk of the backbone.
    pressure : float
        Σ f·r / (2V), in units of the file.
    negative_modes, zero_modes : int
        Number of negative and of vanishing eigenvalues of K with pre-stress on the pinned backbone.
    eigenvalues : tuple of floats
        The lowest few of the same K, ascending, translations left out.
    eigenvalue_error : float
        Largest ‖Kv − λv‖ of these.
    shear_modulus : float
        The lowest quasi-static shear modulus over all directions of shear; negative: unstable.
    proved : bool
        Whether this is a proved minimum; ``None`` if not certified.
    checksum : str
        Of the certified packing: a certificate is not valid for another packing.
    """

    max_force: float | None = None
    rattlers: int | None = None
    contacts: int | None = None
    Z: float | None = None
    pressure: float | None = None
    pressure_error: float | None = None
    stress_error: float | None = None
    negative_modes: int | None = None
    zero_modes: int | None = None
    eigenvalues: tuple[float, ...] | None = None
    eigenvalue_error: float | None = None
    shear_modulus: float | None = None
    proved: bool | None = None
    checksum: str | None = None

    @classmethod
    def stored(cls, values: Mapping[str, Any]) -> Certificate:
        """Return the certificate of ``values`` by the names of the fields; unknown names are left out.

        Raises
        ------
        InputError
            If a value has another type than its field.
        """
        known = {item.name: values.get(item.name) for item in fields(cls)}
        for item in fields(cls):
            check_type(f"{item.name} of the certificate", known[item.name], str(item.type))
        check_shapes("certificate", {"eigenvalues": "C"}, known)
        eigenvalues = known.pop("eigenvalues")
        return cls(eigenvalues=None if eigenvalues is None else tuple(eigenvalues), **known)

    @property
    def lowest_eigenvalue(self) -> float | None:
        """The lowest eigenvalue of K, translations left out."""
        return self.eigenvalues[0] if self.eigenvalues else None


@dataclass(frozen=True, eq=False)
class Packing(Tabular):
    """Disks in a periodic cell, in the units of the source.

    Parameters
    ----------
    positions : array_like, shape (N, 2)
        Any periodic images.
    radii : array_like, shape (N,)
    box : Box
    potential_name : str
        A name from :data:`petscjam.geometry.potential.POTENTIALS`.
    certificate : Certificate
        Default: an empty one.
    provenance : mapping
        Versions, parameters, seed: plain strings and numbers.

    Raises
    ------
    InputError
        On wrong shapes, positions that are not finite, or a radius that is not positive.
    """

    positions: Array
    radii: Array
    box: Box
    potential_name: str = "harmonic"
    certificate: Certificate = Certificate()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        positions, radii = frozen(self.positions), frozen(self.radii)
        if positions.ndim != 2 or positions.shape[1] != 2 or len(positions) == 0:
            raise InputError(f"packing: positions must have shape (N, 2), not {positions.shape}")
        if radii.shape != (len(positions),):
            raise InputError(f"packing: {len(positions)} positions but radii of shape {radii.shape}")
        for name, values, bad in (
            ("position", positions, ~np.isfinite(positions).all(1)),
            ("radius", radii, ~((radii > 0) & np.isfinite(radii))),
        ):
            if bad.any():
                i = int(np.argmax(bad))
                raise InputError(f"packing: the {name} of disk {i} is {values[i]}")
        if not isinstance(self.box, Box):
            raise InputError(f"packing: the box must be a Box, as Box([[Lx, 0], [0, Ly]]), not {shown(self.box)}")
        potential(self.potential_name)
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "radii", radii)

    def __len__(self) -> int:
        return len(self.radii)

    @property
    def potential(self) -> Potential:
        """The contact potential of the packing."""
        return potential(self.potential_name)

    @property
    def phi(self) -> float:
        """Packing fraction Σ π ρ² / V, rattlers included."""
        return float(np.pi * (self.radii**2).sum() / self.box.area)

    @property
    def mean_diameter(self) -> float:
        """Mean diameter d."""
        return float(2 * self.radii.mean())

    @property
    def checksum(self) -> str:
        """SHA-256 of positions, radii, cell and potential (first 16 hex digits)."""
        digest = sha256(self.potential_name.encode())
        for array in (self.positions, self.radii, self.box.cell):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()[:16]

    def facts(self) -> dict[str, Any]:
        """Return size, packing fraction, potential and the certificate, by name."""
        c = self.certificate
        verdict = {None: "not judged", True: "yes", False: "no"}[c.proved]
        known = {"pressure": c.pressure, "Z": c.Z, "rattlers": c.rattlers, "negative modes": c.negative_modes}
        known |= {"lowest eigenvalue": c.lowest_eigenvalue, "shear modulus": c.shear_modulus}
        return {
            "disks": len(self),
            "phi": self.phi,
            "potential": self.potential_name,
            **{name: value for name, value in known.items() if value is not None},
            "proved minimum": verdict,
        }

    def flat(self) -> Table:
        """Return a line for each disk: position and radius."""
        x, y = self.positions.T
        return Table({"x": x, "y": y, "radius": self.radii}, dict.fromkeys(("x", "y", "radius"), "length"))

    @classmethod
    def read(cls, path: str | PathLike[str]) -> Packing:
        """Read a packing of :meth:`write` (H5MD), with all bits equal.

        Raises
        ------
        InputError
            If the file is missing, has another format, is damaged (the checksum is verified), or contains no packing.
        """
        with packing_file.opened(path) as stored:
            packing = cls(
                stored.positions,
                stored.radii,
                Box(stored.cell),
                stored.potential_name,
                Certificate.stored(stored.certificate),
                stored.provenance,
            )
            if packing.checksum != stored.checksum:
                raise InputError(
                    f"the checksum is {packing.checksum} but {stored.checksum} was recorded; "
                    "the file was changed or damaged"
                )
        return packing

    def write(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the packing as H5MD.

        Parameters
        ----------
        path : path
        overwrite : bool
            Replace a file that exists.

        Raises
        ------
        InputError
            If ``path`` exists and ``overwrite`` is not set, or cannot be written.
        """
        known = {name: value for name, value in asdict(self.certificate).items() if value is not None}
        stored = packing_file.Stored(
            self.positions, self.radii, self.box.cell, self.potential_name, self.checksum, known, dict(self.provenance)
        )
        packing_file.write(path, stored, overwrite=overwrite)
