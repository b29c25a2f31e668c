"""GSD of HOOMD-blue; lengths are usually in single precision."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.tables import optional
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.io.reading import Wanted, check_plane

SINGLE = 1e-6  # largest relative difference of diameters in single and in double precision


def read_gsd(path: Path, wanted: Wanted) -> Packing:
    """Read a frame of GSD. Diameters are those of disks, else those of the shapes of their types.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    try:
        with gsd_library().hoomd.open(path) as trajectory:
            index = wanted.one_of(len(trajectory))
            frame = trajectory[index]
        disks = frame.particles
        types = [disks.types[k] for k in disks.typeid]
    except InputError:
        raise
    except (RuntimeError, LookupError, TypeError, ValueError, MemoryError) as error:
        reason = re.sub(rf"[: ]*{re.escape(str(path))}", "", str(error))
        raise InputError(f"damaged GSD file, or not of HOOMD's schema ({reason})") from None
    x, y, z = disks.position.T
    diameters = disks.diameter.astype(float)
    by_default = bool((diameters == 1).all())
    shapes = dict(zip(disks.types, disks.type_shapes or [], strict=False))
    by_shape = {name: _diameter(name, shapes[name]) for name in dict.fromkeys(types) if shapes.get(name)}
    for i, name in enumerate(types):
        if name in by_shape:
            if not by_default and abs(diameters[i] - by_shape[name]) > SINGLE * by_shape[name]:
                raise InputError(
                    f"particles/diameter of disk {i} is {diameters[i]:g}, but {by_shape[name]:g} by the "
                    f"shape of its type {name}"
                )
            diameters[i] = by_shape[name]
    # The default diameter is 1: it may be correct for disks of one type, but not for several types.
    unknown = by_default and len(by_shape) < len({*types}) and (len({*types}) > 1 or wanted.diameters)
    radii = wanted.radii({} if unknown else {"diameter": diameters}, types)
    check_plane(z, radii)
    width, height, _, tilt, _, _ = np.asarray(frame.configuration.box, dtype=float)
    origin: dict[str, Any] = {"source": path.name, "format": "GSD", "index": index, "precision": str(x.dtype)}
    origin["header"] = {"step": int(frame.configuration.step)}
    cell = np.array([[width, 0], [tilt * height, height]])
    return Packing(np.stack([x, y], axis=1), radii, Box(cell), wanted.potential or "harmonic", provenance=origin)


def _diameter(name: str, shape: Any) -> float:
    """Return the diameter of a shape, if it is a disk."""
    diameter = shape.get("diameter") if isinstance(shape, dict) and shape.get("type") == "Sphere" else None
    if not isinstance(diameter, int | float):
        raise InputError(f"type {name} is no disk: its shape in particles/type_shapes is {shape}")
    return float(diameter)


def gsd_library() -> Any:
    """Return the package gsd.

    Raises
    ------
    MissingError
        If it is not installed.
    """
    optional("gsd.fl", "formats")
    optional("gsd.hoomd", "formats")
    return optional("gsd", "formats")
