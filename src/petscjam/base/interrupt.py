"""SIGINT and SIGTERM: recorded when they arrive, handled where the computation can stop.

An exception inside a compiled kernel, PETSc or a row of a run would leave incomplete data, and other ranks would
wait without end. So a signal only sets a flag, and :func:`check` tests it between factorisations, rows and
packings.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


class Interrupted(KeyboardInterrupt):
    """Raised after a signal, where the computation can stop. ``args`` has its number."""

    @property
    def status(self) -> int:
        """Exit status of the command: 130 or 143."""
        return 128 + int(self.args[0])

    def __str__(self) -> str:
        return f"stopped by {signal.Signals(self.args[0]).name}; finished results are kept"


_noted: list[int] = []
_listening = False


@contextmanager
def listening(*signals: signal.Signals) -> Iterator[None]:
    """Record ``signals`` instead of their default action, unless the caller has set a handler."""
    global _listening
    if _listening or threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = {number: signal.getsignal(number) for number in signals}
    usual = {n: now for n, now in usual.items() if now in (signal.SIG_DFL, signal.default_int_handler)}
    _noted.clear()
    for number in usual:
        signal.signal(number, lambda number, _: _noted.append(number))
    _listening = True
    try:
        yield
    finally:
        _listening = False
        for number, handler in usual.items():
            signal.signal(number, handler)


@contextmanager
def deferred() -> Iterator[None]:
    """Defer Ctrl-C to :func:`check` or, at the latest, to the end of the outermost such block."""
    outermost = not _listening
    with listening(signal.SIGINT):
        try:
            yield
        finally:
            if outermost:
                check()


def check(comm: Comm | None = None) -> None:
    """Stop if a signal has arrived at this rank or, with ``comm``, at any of its ranks; then collective.

    Raises
    ------
    Interrupted
        On all ranks of ``comm`` together.
    """
    number = _noted[0] if _noted else 0
    if comm is not None and comm.size > 1:
        number = max(comm.allgather(number))
    if number:
        _noted.clear()
        raise Interrupted(number)
