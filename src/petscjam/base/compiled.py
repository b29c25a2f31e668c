"""Loops compiled by numba: stored on disk if possible, and with threads if they can start."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from petscjam.base.errors import InputError, shown

try:
    import numba

    numba.get_num_threads()  # starts them: a missing threading layer raises here
except Exception as error:
    raise InputError(
        f"numba cannot start: {' '.join(str(error).split())}; its settings are the variables NUMBA_…"
    ) from error

prange = numba.prange
BATCH = 256  # pairs whose scratch arrays stay in the cache of a processor
FAST = {"contract", "reassoc", "arcp", "nsz"}  # sums may be reordered, but NaN stays NaN
MOST_THREADS: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
_forked = False
T = TypeVar("T")


def njit(**options: Any) -> Callable[[T], T]:
    """Return numba.njit with these options; with ``cache`` the compiled code is stored on disk if possible.

    If it cannot be written or read, there is a warning, and the loop is compiled at every start.
    """
    cache = options.pop("cache", False)

    def decorate(function: T) -> T:
        loop = numba.njit(**options)(function)
        if cache and loop is not function:  # true with NUMBA_DISABLE_JIT
            try:
                loop.enable_caching()
            except RuntimeError as error:  # no folder can be written
                _warn(error)
            else:
                kept = loop._cache
                kept.load_overload = _forgiving(kept.load_overload, kept.flush)
                kept.save_overload = _forgiving(kept.save_overload, kept.flush)
        return loop

    return decorate


def _forgiving(work: Callable[..., Any], clear: Callable[[], None]) -> Callable[..., Any]:
    def tried(*arguments: Any) -> Any:
        try:
            return work(*arguments)
        except Exception as error:
            _warn(error)
            with suppress(Exception):  # a damaged file is replaced
                clear()
            return None

    return tried


def _warn(error: Exception) -> None:
    text = f"numba's cache cannot be used ({type(error).__name__}: {error}); every start compiles for a minute"
    warnings.warn(text, RuntimeWarning, stacklevel=2)


def build() -> dict[str, str]:
    """Return what the last bits of a result depend on apart from the source code: numba and the processor."""
    from llvmlite.binding import get_host_cpu_name

    own: str | None = numba.config.CPU_NAME  # type: ignore[attr-defined]
    return {"numba": numba.__version__, "processor": own or get_host_cpu_name()}


def use_threads(count: int) -> None:
    """Let parallel loops have ``count`` threads.

    Raises
    ------
    InputError
        If there are fewer (NUMBA_NUM_THREADS), or this process was forked from one that has threads.
    """
    if not 1 <= count <= MOST_THREADS:
        raise InputError(f"threads must be from 1 to {MOST_THREADS} (NUMBA_NUM_THREADS), not {shown(count)}")
    if count > 1 and _forked:
        raise InputError(
            f"threads = {count}: this process was forked from one that has threads, and can have one only; "
            "start it by spawn (multiprocessing.get_context)"
        )
    numba.set_num_threads(count)


def _remember() -> None:
    global _forked
    _forked = True


os.register_at_fork(after_in_child=_remember)
