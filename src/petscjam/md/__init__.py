"""Sheared massive disks: the molecular dynamics of Vagberg, Olsson & Teitel 2017 (VOT)."""

from importlib import import_module
from typing import Any

_WHERE = {"Run": "result", "read": "result", "run": "runs", "shear": "runs", "ramp": "runs"}
__all__ = list(_WHERE)  # loaded when used: numba takes its time


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'petscjam.md' has no attribute {name!r}")
    return getattr(import_module(f"petscjam.md.{_WHERE[name]}"), name)
