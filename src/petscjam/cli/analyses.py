"""The verbs that analyse the response, and figures; each result is written when it is finished."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from petscjam.base.errors import InputError
from petscjam.cli.laws import chosen_laws, law_options
from petscjam.cli.verbs import analysed, finish, say
from petscjam.parallel.comm import Comm, on_root
from petscjam.rows.damping import DampingLaw


def analyse(options: argparse.Namespace, comm: Comm) -> None:
    """Run the analysis that a verb declares, for all packings.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    result, verb = options.declared
    function = resolve_name(options.analyse) if isinstance(options.analyse, str) else options.analyse
    settings = {name: getattr(options, name) for name in options.settings}
    if "damping" in result.settings or (verb.laws and options.analyse != verb.analyse):
        _analyse(options, comm, function, settings, chosen_laws(options))
    elif verb.laws and law_options(options):
        raise InputError(f"{options.verb}: {law_options(options)[0]} goes with {verb.laws}")
    else:
        _analyse(options, comm, function, settings)


def figure(options: argparse.Namespace, comm: Comm) -> None:
    """Make a figure of a paper: packings, results, picture and page.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    from petscjam.base.progress import progress
    from petscjam.figures import Request, make_figure
    from petscjam.parallel.petsc import start

    start(comm)
    folder = options.output or Path("runs") / options.preset

    def log(line: str) -> None:
        print(line, flush=True)

    with progress(f"figure {options.name}", show=comm.rank == 0) as report:
        request = Request(
            options.name,
            options.preset,
            folder,
            options.parameters,
            overwrite=options.overwrite,
            resume=options.resume,
            existing=options.existing,
        )
        make_figure(request, comm=comm, progress=report, log=log)
    say(comm, on_root(comm, (folder / f"{options.name}.md").read_text))
    say(comm, f"{folder / options.name}.png")


def _analyse(
    options: argparse.Namespace,
    comm: Comm,
    function: Callable[..., Any],
    settings: Mapping[str, Any],
    laws: Sequence[DampingLaw | None] = (None,),
) -> None:
    from petscjam.io.jobs import PackingAnalysis
    from petscjam.parallel.petsc import start

    start(comm)
    finish(analysed(options, comm, PackingAnalysis(function, settings), laws), "results")
