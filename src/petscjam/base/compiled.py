"""Loops compiled by numba: stored on disk if possible, and with threads if they can start."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any, TypeVar, cast

from petscjam.base.errors import InputError, shown
from petscjam.base.progress import compiling

try:
    import numba
    from llvmlite import ir
    from numba.extending import intrinsic

    numba.get_num_threads()  # starts them: a missing threading layer raises here
except Exception as error:
    raise InputError(
        f"numba cannot start: {' '.join(str(error).split())}; its settings are the variables NUMBA_…"
    ) from None

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
                kept.load_overload = _loading(_forgiving(kept.load_overload, kept.flush))
                kept.save_overload = _saving(_forgiving(kept.save_overload, kept.flush))
        return loop

    return decorate


@cache
def compiled(function: Callable[..., Any], what: str) -> Any:
    """Compile a function of one number, for :func:`call`.

    Parameters
    ----------
    function : callable
    what : str
        The object of the function, for the message.

    Raises
    ------
    InputError
        If numba cannot compile it.
    """
    one = numba.njit(error_model="numpy")(function)
    try:  # np.where returns a 0-d array; the product is a number
        return numba.cfunc("float64(float64)", error_model="numpy")(lambda x: 1.0 * one(x))
    except numba.core.errors.NumbaError as error:
        raise InputError(f"{what}: numba cannot compile it: {' '.join(str(error).split())}") from None


@cast(Any, intrinsic)  # type: ignore[untyped-decorator]
def call(context: Any, address: Any, x: Any) -> Any:
    """Call a :func:`compiled` function; a loop that calls it is compiled once for all functions.

    Parameters
    ----------
    address : int
    x : float
    """
    number = numba.float64

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind = ir.FunctionType(ir.DoubleType(), [ir.DoubleType()])
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])

    return number(numba.int64, number), generate


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


def _loading(load: Callable[..., Any]) -> Callable[..., Any]:
    """Note the start of a compilation: there is nothing to load."""

    def loading(*arguments: Any) -> Any:
        found = load(*arguments)
        if found is None:
            compiling(begins=True)
        return found

    return loading


def _saving(save: Callable[..., Any]) -> Callable[..., Any]:
    """Note the end of a compilation."""

    def saving(*arguments: Any) -> Any:
        compiling(begins=False)
        return save(*arguments)

    return saving


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
