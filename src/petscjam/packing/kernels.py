"""The hot loop of packing preparation, compiled by numba: forces over a neighbour list.

Axes: i, j disks of pair c.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def gradient(x, scale, i, j, image, sigma, k, out):
    """Elastic energy U = Σ ½k(σ − r)² of the pairs of a list that overlap, and its gradient.

    Parameters
    ----------
    x : (N, 2)
        Positions in a reference cell; true lengths are ``scale`` times as long.
    scale : float
    i, j : (C,) integers
        Pairs that may overlap; two disks that meet through two images are listed twice.
    image : (C, 2)
        Lattice translation of j in the reference cell: r = scale·|x_j − x_i + image|.
    sigma, k : (C,)
        Sum of radii and spring constant.
    out : (N, 2)
        Overwritten with dU/dx.

    Returns
    -------
    energy : float
    virial : float
        Σ f r, that is −dU/d(ln scale).
    largest : float
        Largest net force on a disk, in true units.
    """
    out[:] = 0.0
    energy = 0.0
    virial = 0.0
    for c in range(len(i)):
        a, b = i[c], j[c]
        dx = x[b, 0] - x[a, 0] + image[c, 0]
        dy = x[b, 1] - x[a, 1] + image[c, 1]
        r2 = scale * scale * (dx * dx + dy * dy)
        if r2 < sigma[c] * sigma[c]:
            r = np.sqrt(r2)
            f = k[c] * (sigma[c] - r)
            energy += 0.5 * f * (sigma[c] - r)
            virial += f * r
            pull = f * scale * scale / r
            out[a, 0] += pull * dx
            out[a, 1] += pull * dy
            out[b, 0] -= pull * dx
            out[b, 1] -= pull * dy
    largest = 0.0
    for a in range(len(x)):
        largest = max(largest, out[a, 0] ** 2 + out[a, 1] ** 2)
    return energy, virial, np.sqrt(largest) / scale


@njit(cache=True)
def farthest(x, x0):
    """Largest distance between a row of ``x`` (N, 2) and the same row of ``x0`` (N, 2)."""
    largest = 0.0
    for a in range(len(x)):
        largest = max(largest, (x[a, 0] - x0[a, 0]) ** 2 + (x[a, 1] - x0[a, 1]) ** 2)
    return np.sqrt(largest)
