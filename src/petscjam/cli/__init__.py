"""The command ``petscjam``: parse, call, print.

Exit status 0 done, 2 bad input, 130 and 143 stopped by SIGINT and SIGTERM, 1 anything else.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import TYPE_CHECKING

from petscjam.base.errors import InputError, SolverError
from petscjam.base.interrupt import Interrupted, listening
from petscjam.cli.streams import Stream

if TYPE_CHECKING:
    from petscjam.parallel.comm import Comm

STOPPING = 10.0  # seconds that ranks wait for each other after a signal


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status, the same on every rank."""
    if arguments is None:
        warnings.formatwarning = lambda text, *_: f"petscjam: warning: {text}\n"
    out, err = Stream(sys.stdout), Stream(sys.stderr)
    with listening(signal.SIGINT, signal.SIGTERM), redirect_stdout(out), redirect_stderr(err):
        try:
            status = _main(arguments)
        finally:
            out.flush()
            if out.error is not None:
                print(f"petscjam: standard output: {out.error.strerror}", file=err)
    if arguments is None:  # all output is complete
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return status or int(out.error is not None)


def _main(arguments: Sequence[str] | None) -> int:
    # A waiting rank yields its core (Open MPI): much faster if other programs use the cores.
    os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")
    from mpi4py import MPI

    from petscjam.parallel.comm import exit_together, world

    argv = list(sys.argv[1:] if arguments is None else arguments)
    leaving = MPI.COMM_WORLD.Dup()
    try:
        return run(argv, world())
    except InputError as error:
        return exit_together(leaving, 2, f"petscjam: {error}")
    except SolverError as error:
        return exit_together(leaving, 1, f"petscjam: {error}")
    except Interrupted as stop:
        return exit_together(leaving, stop.status, f"petscjam: {stop}", STOPPING)
    except Exception:
        return exit_together(leaving, 1, traceback.format_exc())
    finally:
        leaving.Free()


def run(argv: list[str], comm: Comm) -> int:
    """Parse ``argv`` and run the verb.

    Parameters
    ----------
    argv : list of str
    comm : Comm
    """
    from petscjam.cli.config import misspelt
    from petscjam.cli.journal import kept
    from petscjam.cli.parser import build_parser
    from petscjam.parallel.petsc import set_options

    cut = argv.index("--") if "--" in argv else len(argv)
    set_options(argv[cut + 1 :])
    parser = build_parser()
    out, err = (StringIO(), StringIO()) if comm.rank else (sys.stdout, sys.stderr)  # --help prints once
    with redirect_stdout(out), redirect_stderr(err):
        options, unknown = parser.parse_known_args(join_negative(argv[:cut]))
    if unknown:
        raise InputError(misspelt(unknown[0], options.known))
    with kept(argv, options, comm):
        options.work(options, comm)
    return 0


def join_negative(argv: list[str]) -> list[str]:
    """Turn ``--omega -1:1:5`` into ``--omega=-1:1:5``: argparse would read the value as an option."""
    joined: list[str] = []
    for word in argv:
        if joined and re.match(r"-[\d.]", word) and re.fullmatch(r"--[a-z-]+", joined[-1]):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined
