"""What a command says of its work: nothing with ``-q``, more with ``-v``, and all of it in the file of ``--log``."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, TextIO

from petscjam.base.errors import InputError
from petscjam.base.files import check_folder, naming
from petscjam.base.interrupt import Interrupted
from petscjam.base.progress import quiet
from petscjam.base.versions import release
from petscjam.parallel.comm import Comm, on_root


@contextmanager
def kept(argv: list[str], options: argparse.Namespace, comm: Comm) -> Iterator[None]:
    """Run the block of a verb as ``--quiet``, ``--verbose`` and ``--log`` say.

    Parameters
    ----------
    argv : list of str
        The command line.
    options : argparse.Namespace
    comm : Comm

    Raises
    ------
    InputError
        If the log cannot be written, or the file of ``--config`` is an output, too.
    """
    inputs = [options.config] if options.config else []
    output = getattr(options, "output", None)
    if output is not None and any(_same(output, one) for one in inputs):
        raise InputError(f"{output}: is an input, too; choose another name")
    start = time.monotonic()
    with ExitStack() as held:
        log = on_root(comm, lambda: options.log and _checked(options.log, [*inputs, output]))
        if log:
            with naming(log):
                file = held.enter_context(open(log, "a", encoding="utf-8", buffering=1))  # whole lines of all ranks
            if comm.rank == 0:
                file.write(f"{time.strftime('%Y-%m-%dT%H:%M:%S%z')} {shlex.join(['petscjam', *argv])}\n")
            for redirect, stream in ((redirect_stdout, sys.stdout), (redirect_stderr, sys.stderr)):
                held.enter_context(redirect(_Both(stream, file)))
        if options.quiet:
            held.enter_context(quiet())
            held.enter_context(redirect_stdout(StringIO()))
        if options.verbose and comm.rank == 0:
            print(f"petscjam {release('petscjam')}, {comm.size} ranks, process {os.getpid()}", file=sys.stderr)
        try:
            yield
        except (Exception, Interrupted) as error:
            if comm.rank == 0:
                if options.verbose:
                    traceback.print_exc()
                elif log:
                    file.write(f"petscjam: {error}\n")
            raise
        finally:
            if options.verbose and comm.rank == 0:
                print(f"petscjam: {time.monotonic() - start:.1f} s", file=sys.stderr, flush=True)


def _checked(log: Path, others: list[Path | None]) -> Path:
    check_folder(log)
    if log.exists() and not log.is_file():
        raise InputError(f"{log}: is a folder or a device, not a file")
    if any(other is not None and _same(log, other) for other in others):
        raise InputError(f"{log}: is an input or an output, too; choose another name")
    return log


def _same(a: Path, b: Path) -> bool:
    return a.resolve() == b.resolve() or (a.exists() and b.exists() and os.path.samefile(a, b))


class _Both:
    """A stream whose text is also appended to a file."""

    def __init__(self, stream: Any, file: TextIO) -> None:
        self._stream, self._file = stream, file

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write to both."""
        self._file.write(text)
        self._stream.write(text)
        return len(text)

    def isatty(self) -> bool:
        """No bars in a log."""
        return False

    def flush(self) -> None:
        """Flush both."""
        self._file.flush()
        self._stream.flush()
