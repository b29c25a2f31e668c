"""SIGINT and SIGTERM: noted when they come, obeyed where the work can stop.

An exception in the middle of a compiled kernel, of PETSc or of a row of a run leaves half of something, and
on several ranks the others waiting. So a signal only sets a flag, and :func:`check` looks at it between
factorisations, rows, packings.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Interrupted(KeyboardInterrupt):
    """A signal, where the work can stop. ``args`` holds its number."""

    @property
    def status(self) -> int:
        """Exit status of the command: 130 or 143."""
        return 128 + int(self.args[0])

    def __str__(self) -> str:
        return f"stopped by {signal.Signals(self.args[0]).name}; what was finished is kept"


_noted: list[int] = []
_listening = False


@contextmanager
def listening(*signals: signal.Signals) -> Iterator[None]:
    """Note ``signals`` instead of what they would do, unless that is the caller's own choice."""
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
    """Let Ctrl-C wait for :func:`check` or, at the latest, the end of the outermost such block."""
    outermost = not _listening
    with listening(signal.SIGINT):
        try:
            yield
        finally:
            if outermost:
                check()


def check(comm: Any = None) -> None:
    """Stop if a signal has come: to this rank or, where ``comm`` is given, any of its ranks; collective.

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
