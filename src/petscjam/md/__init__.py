"""Sheared massive disks: the molecular dynamics of Vagberg, Olsson & Teitel 2017 (VOT)."""

from petscjam.md.result import Run, read
from petscjam.md.shear import ramp, run, shear

__all__ = ["Run", "ramp", "read", "run", "shear"]
