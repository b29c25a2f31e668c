"""Progress with an estimate of the time left: a bar on a terminal, plain lines in a batch log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TypeAlias, TypeVar

Report = Callable[[float, str], None]
Progress: TypeAlias = Report | Any  # or True: see reporting
P = ParamSpec("P")
R = TypeVar("R")
LINE_EVERY = 10.0  # seconds between lines of a log
_shown: list[str] = []  # labels of the reports that are shown now
_quiet: list[bool] = []


def part(report: Report, k: int, n: int, label: str = "") -> Report:
    """Return the report of the k-th of ``n`` equal parts.

    Parameters
    ----------
    report : Report
    k, n : int
        0 ≤ k < n.
    label : str
        Prefix of the text.
    """
    return lambda fraction, text: report((k + fraction) / n, label + text)


@contextmanager
def progress(label: str, *, show: bool) -> Iterator[Report]:
    """Yield a function of the completed fraction and a text; it prints only with ``show`` (rank 0).

    Parameters
    ----------
    label : str
        Prefix of each text.
    show : bool
    """
    if not show or _quiet:
        yield lambda fraction, text: None
        return
    _shown.append(label)
    try:
        if sys.stderr.isatty():
            with _bar(label) as report:
                yield report
        else:
            yield _lines(label)
    finally:
        _shown.pop()


@contextmanager
def quiet() -> Iterator[None]:
    """Show no progress in the block."""
    _quiet.append(True)
    try:
        yield
    finally:
        _quiet.pop()


class _Compiling:
    """Time of compilation in this process, which is no part of an estimate of the time left."""

    said = False
    depth = 0
    since = 0.0
    seconds = 0.0


def compiling(begins: bool) -> None:
    """Note that the compilation of a loop begins or ends; the first one is announced if progress is shown."""
    c = _Compiling
    if begins:
        if _shown and not c.said:
            c.said = True
            print(f"{_shown[-1]}: compiling for this processor, once, about half a minute", file=sys.stderr, flush=True)
        c.since = c.since if c.depth else time.monotonic()
        c.depth += 1
    elif c.depth:
        c.depth -= 1
        if not c.depth:
            c.seconds += time.monotonic() - c.since


def reporting(function: Callable[P, R]) -> Callable[P, R]:
    """Let ``function`` take ``progress=True``: :func:`progress`, on rank 0 of its ``comm``."""
    label = function.__name__.replace("_", " ")

    @wraps(function)
    def reported(*args: P.args, **kwargs: P.kwargs) -> R:
        given: Any = kwargs.get("progress")
        if not isinstance(given, bool):
            return function(*args, **kwargs)
        comm: Any = kwargs.get("comm")
        with progress(label, show=given and getattr(comm, "rank", 0) == 0) as report:
            kwargs["progress"] = report
            return function(*args, **kwargs)

    return reported


@contextmanager
def _bar(label: str) -> Iterator[Report]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    with Progress(
        TextColumn(label),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}"),
        console=Console(stderr=True),
    ) as bar:
        task = bar.add_task(label, total=1.0, text="")
        yield lambda fraction, text: bar.update(task, completed=fraction, text=text)


def _lines(label: str) -> Report:
    start = time.monotonic()
    last, compiled = start, _Compiling.seconds

    def report(fraction: float, text: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < LINE_EVERY and fraction < 1:
            return
        last = now
        elapsed = now - start
        worked = elapsed - (_Compiling.seconds - compiled)
        left = f", {worked * (1 / fraction - 1):.0f} s left" if 0 < fraction < 1 else ""
        print(f"{label}: {100 * fraction:.0f} %, {elapsed:.0f} s{left}; {text}", file=sys.stderr, flush=True)

    return report
