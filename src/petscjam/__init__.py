"""petscjam: the linear response of jammed packings at every frequency, on PETSc.

Nothing heavy is imported until it is used.
"""

from importlib import import_module
from typing import Any

_WHERE = {
    "Box": "box",
    "InputError": "errors",
    "SolverError": "errors",
    "Packing": "packing.packing",
    "Certificate": "packing.packing",
    "prepare_packing": "packing.prepare",
    "relax_packing": "packing.prepare",
    "prepare_library": "packing.library",
    "read_library": "packing.library",
    "certify": "packing.certify",
    "import_packing": "io.importers",
    "export_packing": "io.exporters",
    "export_rheology": "io.rheology",
    "ContactNetwork": "network",
    "ContactDamping": "damping",
    "StokesDrag": "damping",
    "ComplexModulus": "response.result",
    "complex_modulus": "response.moduli",
    "Spectrum": "response.spectrum",
    "spectrum": "response.reduced",
    "beta_family": "response.family",
    "average": "ensemble",
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
