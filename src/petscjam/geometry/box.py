"""Geometry of a sheared periodic cell.

Axes: i disk, c pair or contact, x Cartesian, l lattice vector.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError
from petscjam.base.types import Array, frozen


@dataclass(frozen=True, eq=False)
class Box:
    """A periodic cell in two dimensions, as tilted as one likes.

    Parameters
    ----------
    cell : array_like, shape (2, 2)
        Rows are the lattice vectors, in the length unit of the packing.

    Raises
    ------
    InputError
        If the shape is wrong, an entry is not finite, or the vectors are parallel.
    """

    cell: Array

    def __post_init__(self) -> None:
        cell = frozen(self.cell)
        if cell.shape != (2, 2):
            raise InputError(f"box: the cell must be 2x2 (rows are lattice vectors), not {cell.shape}")
        if not np.isfinite(cell).all():
            raise InputError(f"box: the cell has entries that are not finite: {cell.tolist()}")
        if not abs(np.linalg.det(cell)) > 1e-12 * np.prod(np.linalg.norm(cell, axis=1)):
            raise InputError(f"box: the lattice vectors {cell.tolist()} span no area")
        object.__setattr__(self, "cell", cell)

    @classmethod
    def square(cls, length: float) -> Box:
        """Return a square cell with edges of ``length``."""
        return cls(length * np.eye(2))

    @property
    def area(self) -> float:
        """Area V of the cell."""
        return float(abs(np.linalg.det(self.cell)))

    @cached_property
    def reduced(self) -> Array:
        """The same lattice by its two shortest vectors (Lagrange–Gauss reduction), shape (2, 2)."""
        a, b = sorted(self.cell, key=lambda v: float(v @ v))
        while True:
            b = b - np.rint(a @ b / (a @ a)) * a
            if b @ b >= (1 - 1e-12) * (a @ a):
                return frozen([a, b])
            a, b = b, a

    def fractional(self, positions: ArrayLike) -> Array:
        """Return ``positions`` (…, 2) in units of the lattice vectors."""
        return np.asarray(positions) @ np.linalg.inv(self.cell)

    def wrap(self, positions: ArrayLike) -> Array:
        """Return the images of ``positions`` (…, 2) that lie in the cell."""
        s = self.fractional(positions)
        return np.asarray(positions) - np.floor(s) @ self.cell

    def minimum_image(self, separations: ArrayLike) -> Array:
        """Return the shortest periodic image of each separation (…, 2), at any tilt."""
        d = np.asarray(separations, dtype=float)
        d = d - np.rint(d @ np.linalg.inv(self.reduced)) @ self.reduced
        images = d[..., None, :] + _SHELL @ self.reduced
        nearest = np.argmin((images**2).sum(-1), axis=-1)
        return np.take_along_axis(images, nearest[..., None, None], axis=-2)[..., 0, :]

    def deformed(self, gradient: ArrayLike) -> Box:
        """Return the cell after the deformation x → F x."""
        return Box(self.cell @ np.asarray(gradient).T)


_SHELL = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)], dtype=float)
