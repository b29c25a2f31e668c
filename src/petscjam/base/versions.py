"""Versions of packages."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def release(package: str) -> str:
    """Return the version of an installed package, or ``unknown``."""
    try:
        return version(package)
    except PackageNotFoundError:  # run from a source tree
        return "unknown"


__version__ = release("petscjam")
