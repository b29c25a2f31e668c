"""The kinds of results, and of files. docs/howto/extend.md adds a kind of results."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from os import PathLike
from pathlib import Path
from pkgutil import resolve_name
from typing import NamedTuple

from petscjam.base.files import h5_format
from petscjam.base.registry import Registry
from petscjam.md.result import FORMAT as RUN
from petscjam.md.result import is_run
from petscjam.response.origin import Result


class Kind(NamedTuple):
    """A kind of results. A module is imported where it is needed, so that the command starts at once.

    Attributes
    ----------
    place : str
        Its class, ``module:name``.
    text : str
        The help text of its verb; empty if it has no verb of its own.
    verb : str
        The name of its verb, if that is not the name of the kind.
    """

    place: str
    text: str = ""
    verb: str = ""


def _summary(point: EntryPoint) -> str:
    return f"analysis of the package {point.dist.name}: {point.dist.metadata['Summary']}" if point.dist else point.value


# Files have the format "petscjam KIND". An entry point petscjam.analyses names the class of its results.
KINDS = Registry(
    {
        "moduli": Kind("petscjam.response.result:ComplexModulus"),
        "nonaffine": Kind(
            "petscjam.analysis.nonaffine:QuasistaticResponse",
            "quasi-static response per unit strain: relative displacements at contacts, non-affine displacements",
        ),
        "modes": Kind("petscjam.response.modes:Modes", "lowest modes of the stiffness, or slowest relaxations"),
        "relaxations": Kind("petscjam.response.relaxations:RelaxationModes"),
        "rebuilt": Kind("petscjam.analysis.mode_sum:ModeSum"),
        "density": Kind(
            "petscjam.analysis.density:DensityOfStates", "density of states D(omega) of all modes, unit masses"
        ),
        "correlations": Kind(
            "petscjam.analysis.correlations:Correlations",
            "correlation length of non-affine displacements along x, at any frequency",
        ),
        "drag": Kind(
            "petscjam.analysis.drag:NonlinearModulus",
            "G*(omega) under nonlinear drag |v|^(alpha-1) v, by equivalent damping",
            "nonlinear-drag",
        ),
        "oscillations": Kind(
            "petscjam.analysis.oscillation:Oscillations",
            "G*(omega) at finite amplitudes, by the disk engine, with harmonics and contact changes",
            "oscillate",
        ),
        "steps": Kind(
            "petscjam.analysis.step_strain:StepStrain",
            "stress after a step of strain of any size, by the disk engine, with the linear G(t)",
            "step-strain",
        ),
        "viscosity": Kind("petscjam.analysis.viscosity:Viscosity", "viscosity eta0 and modulus G0 at omega -> 0"),
        "aqs": Kind(
            "petscjam.analysis.aqs:ShearPath",
            "athermal quasi-static shear: stress, contacts, instabilities, every event located to 1e-10 in strain",
        ),
    },
    "petscjam.analyses",
    lambda point: Kind(point.value, _summary(point)),
)
PREFIX, SPECTRUM = "petscjam ", "petscjam spectrum"


def class_of(kind: str) -> type[Result]:
    """Return the class of the results of a ``kind``."""
    found: type[Result] = resolve_name(KINDS[kind].place)
    return found


def kind_of(result: type[Result]) -> str:
    """Return the kind of results of a class."""
    return next(name for name, kind in KINDS.items() if kind.place == f"{result.__module__}:{result.__name__}")


def recognise(path: str | PathLike[str]) -> str:
    """Return the content of ``path``: ``library`` or ``runs`` (folders), ``run``, ``results`` or ``packing``.

    A packing may have any format: :func:`petscjam.import_packing` recognises it, or refuses the file.

    Raises
    ------
    InputError
        If the file is missing or damaged.
    """
    if Path(path).is_dir():
        return "runs" if any(is_run(file) for file in Path(path).glob("*.h5")) else "library"
    said = h5_format(path) or ""
    if said == RUN:
        return "run"
    return "results" if said == SPECTRUM or said.removeprefix(PREFIX) in KINDS else "packing"
