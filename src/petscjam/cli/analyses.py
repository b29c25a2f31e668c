"""The verbs that ask what the response says; each packing's result is written as it comes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from petscjam.base.errors import InputError
from petscjam.cli.laws import chosen_laws, law_options
from petscjam.cli.verbs import analysed, finish, say
from petscjam.parallel.comm import on_root
from petscjam.rows.damping import DampingLaw


def nonaffine(options: argparse.Namespace, comm: Any) -> None:
    """Find the quasi-static response of packing after packing."""
    from petscjam.analysis.nonaffine import quasistatic_response

    _analyse(options, comm, quasistatic_response, {"strain": options.strain})


def modes(options: argparse.Namespace, comm: Any) -> None:
    """Find the lowest modes, or the slowest relaxations, of packing after packing."""
    from petscjam.response.modes import lowest_modes
    from petscjam.response.relaxations import relaxation_modes

    settings = {"count": options.count, "strain": options.strain}
    if options.relaxation:
        _analyse(options, comm, relaxation_modes, settings, chosen_laws(options))
    elif law_options(options):
        raise InputError(f"modes: {law_options(options)[0]} goes with --relaxation")
    else:
        _analyse(options, comm, lowest_modes, settings)


def density(options: argparse.Namespace, comm: Any) -> None:
    """Find the density of states of packing after packing."""
    from petscjam.analysis.density import density_of_states

    settings = {"moments": options.moments, "vectors": options.vectors, "seed": options.seed}
    _analyse(options, comm, density_of_states, settings)


def correlations(options: argparse.Namespace, comm: Any) -> None:
    """Find the correlations of packing after packing."""
    from petscjam.analysis.correlations import correlations

    settings = {"omegas": options.omega, "width": options.width, "bin": options.bin}
    _analyse(options, comm, correlations, settings, chosen_laws(options))


def drag(options: argparse.Namespace, comm: Any) -> None:
    """Find G* of packing after packing under nonlinear drag."""
    from petscjam.analysis.contact_drag import self_consistent_drag
    from petscjam.analysis.drag import equivalent_drag

    settings = {"omegas": options.omega, "stress": options.stress, "alpha": options.alpha, "strain": options.strain}
    _analyse(options, comm, equivalent_drag if options.uniform else self_consistent_drag, settings)


def viscosity(options: argparse.Namespace, comm: Any) -> None:
    """Find η0 of packing after packing."""
    from petscjam.analysis.viscosity import viscosity

    _analyse(options, comm, viscosity, {"strain": options.strain}, chosen_laws(options))


def figure(options: argparse.Namespace, comm: Any) -> None:
    """Make a figure from packings on."""
    from petscjam.base.progress import progress
    from petscjam.figures import make_figure
    from petscjam.parallel.petsc import start

    start(comm)
    folder = options.output or Path("runs") / options.preset

    def log(line: str) -> None:
        print(line, flush=True)

    with progress(f"figure {options.name}", show=comm.rank == 0) as report:
        make_figure(
            options.name,
            options.preset,
            folder,
            file=options.parameters,
            comm=comm,
            overwrite=options.overwrite,
            resume=options.resume,
            existing=options.existing,
            progress=report,
            log=log,
        )
    say(comm, on_root(comm, (folder / f"{options.name}.md").read_text))
    say(comm, f"{folder / options.name}.png")


def _analyse(
    options: argparse.Namespace,
    comm: Any,
    function: Callable[..., Any],
    settings: Mapping[str, Any],
    laws: Sequence[DampingLaw | None] = (None,),
) -> None:
    from petscjam.io.jobs import PackingAnalysis
    from petscjam.parallel.petsc import start

    start(comm)
    finish(analysed(options, comm, PackingAnalysis(function, settings), laws), "results")
