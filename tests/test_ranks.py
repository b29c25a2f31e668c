"""Ranks that are given different arguments are told so, and do not wait for each other."""

from inspect import signature
from pathlib import Path

import pytest
from helpers import SIXTEEN, sixteen

import petscjam as pj
from petscjam.figures import Request, make_figure
from petscjam.io.jobs import Ensemble, ModulusAnalysis, PackingAnalysis, analyse
from petscjam.md.grid import grid, run_grid
from petscjam.md.runs import begin

PACKING = sixteen()
OTHER = pj.Packing(PACKING.positions, 1.01 * PACKING.radii, PACKING.box, PACKING.potential_name)
SPAN = (1e-2, 1.0)

# What a rank calls; it is given its packing, whether it is the odd one, and what all have: a folder and comm.
ENTRIES = {
    "complex_modulus": lambda p, odd, folder, **c: pj.complex_modulus(p, [0.1], **c),
    "complex_modulus, fields": lambda p, odd, folder, **c: pj.complex_modulus(
        PACKING, [0.1], fields_at=[0.2] if odd else [], **c
    ),
    "spectrum": lambda p, odd, folder, **c: pj.spectrum(p, SPAN, **c),
    "spectrum, no packing": lambda p, odd, folder, **c: pj.spectrum(None if odd else p, SPAN, **c),
    "spectrum, out of core": lambda p, odd, folder, **c: pj.spectrum(PACKING, SPAN, out_of_core=odd, **c),
    "spectrum, span": lambda p, odd, folder, **c: pj.spectrum(PACKING, (0.1, -1.0) if odd else SPAN, **c),
    "beta_family": lambda p, odd, folder, **c: pj.beta_family(p, (0.1, 1.0), SPAN, **c),
    "beta_family, block low-rank": lambda p, odd, folder, **c: pj.beta_family(
        PACKING, (0.1, 1.0), SPAN, block_low_rank=1e-9 * odd, **c
    ),
    "elastic_constants": lambda p, odd, folder, **c: pj.elastic_constants(p, **c),
    "lowest_modes": lambda p, odd, folder, **c: pj.lowest_modes(p, 4, **c),
    "lowest_modes, count": lambda p, odd, folder, **c: pj.lowest_modes(PACKING, -1 if odd else 4, **c),
    "mode_sum": lambda p, odd, folder, **c: pj.mode_sum(p, 4, **c),
    "relaxation_modes": lambda p, odd, folder, **c: pj.relaxation_modes(p, 4, **c),
    "density_of_states": lambda p, odd, folder, **c: pj.density_of_states(p, moments=8, vectors=2, **c),
    "correlations": lambda p, odd, folder, **c: pj.correlations(p, [0.1], **c),
    "correlations, ω": lambda p, odd, folder, **c: pj.correlations(PACKING, [-1.0 if odd else 0.1], **c),
    "quasistatic_response": lambda p, odd, folder, **c: pj.quasistatic_response(p, **c),
    "aqs": lambda p, odd, folder, **c: pj.aqs(p, 1e-4, **c),
    "aqs, strain": lambda p, odd, folder, **c: pj.aqs(PACKING, -1e-4 if odd else 1e-4, **c),
    "oscillate": lambda p, odd, folder, **c: pj.oscillate(p, [1e-4], [1.0], cycles=3, **c),
    "step_strain": lambda p, odd, folder, **c: pj.step_strain(p, [1e-4], [10.0], **c),
    "viscosity": lambda p, odd, folder, **c: pj.viscosity(p, **c),
    "equivalent_drag": lambda p, odd, folder, **c: pj.equivalent_drag(p, [0.1], 1e-3, 0.6, **c),
    "equivalent_drag, α": lambda p, odd, folder, **c: pj.equivalent_drag(
        PACKING, [0.1], 1e-3, -1.0 if odd else 0.6, **c
    ),
    "self_consistent_drag": lambda p, odd, folder, **c: pj.self_consistent_drag(p, [0.1], 1e-3, 0.6, **c),
    "nonlinear_drag": lambda p, odd, folder, **c: pj.nonlinear_drag(p, [0.1], 1e-3, 0.6, **c),
    "prepare_library": lambda p, odd, folder, **c: pj.prepare_library(
        folder / "lib", [16], [1e-2], ratio=1.2 if odd else 1.4, **c
    ),
    "prepare_library, seeds": lambda p, odd, folder, **c: pj.prepare_library(
        folder / "lib", [16], [1e-2], range(1, 3 + odd), **c
    ),
    "prepare_library, recipe": lambda p, odd, folder, **c: pj.prepare_library(
        folder / "lib", [16], [1e-2], **({"sizes": 1} if odd else {}), **c
    ),
    "analyse, laws": lambda p, odd, folder, **c: analyse(
        Ensemble([SIXTEEN], folder / "g.h5", [pj.ContactDamping(0.1 + odd)]), ModulusAnalysis([0.1, 1.0]), **c
    ),
    "analyse, frequencies": lambda p, odd, folder, **c: analyse(
        Ensemble([SIXTEEN], folder / "g.h5", [pj.ContactDamping()]), ModulusAnalysis([0.1, 1.0 + odd]), **c
    ),
    "analyse, options": lambda p, odd, folder, **c: analyse(
        Ensemble([SIXTEEN], folder / "s.h5"),
        PackingAnalysis(pj.viscosity, {"strain": "pure-shear" if odd else "simple-shear"}),
        **c,
    ),
    "run_grid": lambda p, odd, folder, **c: run_grid(
        grid(["CD"], [16], [0.8], [1.0], [1e-2], [1 + odd]), folder / "grid", begin, log=print, **c
    ),
    "make_figure": lambda p, odd, folder, **c: make_figure(
        Request("bt1", "small", folder / "figures", overwrite=odd), **c
    ),
}


@pytest.mark.parallel(2)
@pytest.mark.parametrize("entry", ENTRIES)
def test_ranks_that_disagree_are_told(comm, tmp_path, entry):
    folder = Path(comm.bcast(str(tmp_path)))
    odd = comm.rank == 1
    with pytest.raises(pj.InputError, match="differ between the ranks"):
        ENTRIES[entry](OTHER if odd else PACKING, odd, folder, comm=comm)
    comm.barrier()
    assert list(folder.iterdir()) == []


def test_the_list_is_that_of_the_api():
    """Whatever has a communicator is in the list above."""
    public = {name: getattr(pj, name) for name in pj.__all__}
    collective = {name for name, one in public.items() if callable(one) and "comm" in signature(one).parameters}
    assert collective <= {entry.split(",")[0] for entry in ENTRIES}
