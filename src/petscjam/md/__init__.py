"""Sheared massive disks: the molecular dynamics of Vagberg, Olsson & Teitel 2017 (VOT)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # numba takes its time
