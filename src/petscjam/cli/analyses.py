"""The verbs that ask what the response says; each packing's result is written as it comes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from petscjam.cli.laws import chosen_laws
from petscjam.cli.verbs import all_packings, check_team_size, finish, say
from petscjam.damping import DampingLaw
from petscjam.parallel.comm import on_root


def nonaffine(options: argparse.Namespace, comm: Any) -> None:
    """Find the quasi-static response of packing after packing."""
    from petscjam.analysis.nonaffine import quasistatic_response

    _survey(options, comm, quasistatic_response, {"strain": options.strain})


def viscosity(options: argparse.Namespace, comm: Any) -> None:
    """Find η0 of packing after packing."""
    from petscjam.analysis.viscosity import viscosity

    _survey(options, comm, viscosity, {"strain": options.strain}, chosen_laws(options))


def _survey(
    options: argparse.Namespace,
    comm: Any,
    analyse: Callable[..., Any],
    settings: Mapping[str, Any],
    laws: Sequence[DampingLaw | None] = (None,),
) -> None:
    from petscjam.ensemble import survey
    from petscjam.io.results import read_results
    from petscjam.parallel.petsc import start
    from petscjam.progress import progress
    from petscjam.report import table

    check_team_size(options)
    start(comm)
    with progress(options.verb, show=comm.rank == 0) as report:
        made, failures = survey(
            on_root(comm, all_packings, options.packings), options.output, analyse, settings, laws=laws,
            prestress=options.prestress, comm=comm, team_size=options.team_size, resume=options.resume,
            overwrite=options.overwrite, progress=report, log=lambda line: print(line, flush=True),
        )  # fmt: skip
    if made or options.resume:
        say(comm, on_root(comm, lambda: table(read_results(options.output))))
    finish(failures, "results")
