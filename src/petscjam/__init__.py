"""petscjam: the linear response of jammed packings at every frequency, on PETSc.

Nothing heavy is imported until it is used.
"""

from importlib import import_module
from typing import Any

_WHERE = {
    "Box": "geometry.box",
    "InputError": "base.errors",
    "SolverError": "base.errors",
    "Packing": "geometry.packing",
    "Certificate": "geometry.packing",
    "prepare_packing": "preparation.prepare",
    "relax_packing": "preparation.prepare",
    "prepare_library": "preparation.library",
    "read_library": "preparation.library",
    "certify": "preparation.certify",
    "import_packing": "io.importers",
    "export_packing": "io.exporters",
    "export_rheology": "io.rheology",
    "ContactNetwork": "geometry.network",
    "ContactDamping": "rows.damping",
    "StokesDrag": "rows.damping",
    "ComplexModulus": "response.result",
    "complex_modulus": "response.moduli",
    "Spectrum": "response.spectrum",
    "spectrum": "response.reduced",
    "beta_family": "response.family",
    "average": "io.jobs",
    "elastic_constants": "response.moduli",
    "lowest_modes": "response.modes",
    "rebuilt_response": "analysis.rebuilt",
    "relaxation_modes": "response.relaxations",
    "density_of_states": "analysis.density",
    "correlations": "analysis.correlations",
    "equivalent_drag": "analysis.drag",
    "self_consistent_drag": "analysis.contact_drag",
    "quasistatic_response": "analysis.nonaffine",
    "viscosity": "analysis.viscosity",
    "read_results": "io.results",
    "write_spectrum": "io.results",
    "read_spectrum": "io.results",
    "read_modulus": "io.results",
    "read_moduli": "io.results",
}

__all__ = [*_WHERE, "md"]


def __getattr__(name: str) -> Any:
    if name == "md":
        return import_module("petscjam.md")
    if name not in _WHERE:
        raise AttributeError(f"module 'petscjam' has no attribute {name!r}")
    return getattr(import_module(f"petscjam.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
