"""Geometry of a sheared periodic cell.

Axes: i disk, c pair or contact, x Cartesian, l lattice vector.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError
from petscjam.base.types import Array, Integers, frozen


@dataclass(frozen=True, eq=False)
class Box:
    """A periodic cell in two dimensions, with any tilt.

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

    @classmethod
    def filled(cls, radii: Array, phi: float) -> Box:
        """Return the square cell in which disks have the packing fraction ``phi``.

        Parameters
        ----------
        radii : (N,)
        phi : float
            Σ πρ²/V.
        """
        return cls.square(float(np.sqrt(np.pi * (radii**2).sum() / phi)))

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

    def images(self, points: Array, reach: float | Array, window: Box | None = None) -> tuple[Integers, Array]:
        """Find the periodic images of points that lie in a window or near it.

        Parameters
        ----------
        points : (P, 2)
        reach : float or (P, 1)
            Largest distance of an image from the window.
        window : Box
            Left out: the cell itself.

        Returns
        -------
        which : (I,)
            The point of each image.
        images : (I, 2)
        """
        window = window or self
        margin = reach * np.linalg.norm(np.linalg.inv(window.cell), axis=0)  # in units of each lattice vector
        s = self.fractional(points)
        s = s - np.floor(s)
        most = np.ceil(margin.reshape(-1, 2).max(0)).astype(int) + (window is not self)
        shells = [np.arange(-m, m + 1) for m in most]
        which, where = [], []
        for shift in np.array(np.meshgrid(*shells)).reshape(2, -1).T:
            x = (s + shift) @ self.cell
            inside = s + shift if window is self else window.fractional(x)
            near = np.flatnonzero(((inside > -margin) & (inside < 1 + margin)).all(1))
            which.append(near)
            where.append(x[near])
        return np.concatenate(which), np.concatenate(where)

    def deformed(self, gradient: ArrayLike) -> Box:
        """Return the cell after the deformation x → F x."""
        return Box(self.cell @ np.asarray(gradient).T)


_SHELL = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)], dtype=float)
