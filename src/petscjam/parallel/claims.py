"""Outputs claimed for a whole run, so that two runs never write to one file or folder.

A claim is a file in the folder of the output, or inside a claimed folder, that is created exclusively and names
the process that writes; the file system needs no locks. The claim of a process of this machine that has ended is
ignored.
"""

from __future__ import annotations

import json
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path

from petscjam.base.errors import InputError
from petscjam.base.files import check_folder, naming
from petscjam.parallel.comm import Comm, on_root

PATIENCE = 2.0  # seconds that a claim may be empty, or be in removal by another process
_held: set[tuple[Path, int]] = set()  # claims and processes: a forked child does not own the claims of its parent


@contextmanager
def claimed(path: str | PathLike[str], comm: Comm | None = None) -> Iterator[None]:
    """Prevent other runs from writing to ``path``, a file or an existing folder, during the block.

    The process may claim it again inside the block. With ``comm`` this is collective, and rank 0 makes the claim.

    Parameters
    ----------
    path : str or PathLike
    comm : Comm, optional

    Raises
    ------
    InputError
        If another run has claimed it, or its folder is missing or not writable.
    """
    lock = _take(path) if comm is None else on_root(comm, _take, path)
    try:
        yield
    finally:
        if lock is not None and (lock, os.getpid()) in _held:
            _held.remove((lock, os.getpid()))
            with suppress(OSError):
                lock.unlink()


@contextmanager
def made_folder(folder: str | PathLike[str], comm: Comm | None = None) -> Iterator[None]:
    """Make ``folder`` if necessary; if the block raises an error and the folder is empty, remove it again.

    With ``comm`` this is collective.

    Parameters
    ----------
    folder : str or PathLike
    comm : Comm, optional

    Raises
    ------
    InputError
        If it cannot be made.
    """

    def make() -> list[Path]:
        inside_out = [Path(folder), *Path(folder).parents]
        new = [one for one in inside_out if not one.exists()]
        with naming(folder):
            Path(folder).mkdir(parents=True, exist_ok=True)
        return new

    new = make() if comm is None else on_root(comm, make)
    try:
        yield
    except InputError:
        with suppress(OSError):
            for one in new if comm is None or comm.rank == 0 else ():
                one.rmdir()
        raise


@contextmanager
def turn(path: str | PathLike[str]) -> Iterator[None]:
    """Let the other ranks of this run wait while ``path`` is read, changed and replaced."""
    ticket = _beside(path, "turn")
    with naming(path):
        while not _created(ticket, ""):
            time.sleep(0.01)
    try:
        yield
    finally:
        ticket.unlink()


def _beside(path: str | PathLike[str], ending: str) -> Path:
    target = Path(os.path.realpath(path))
    return target / f".{ending}" if target.is_dir() else target.with_name(f".{target.name}.{ending}")


def _take(path: str | PathLike[str]) -> Path | None:
    """Create the claim of this process; None if it has one."""
    if not os.path.isdir(path):
        check_folder(path)
    lock = _beside(path, "lock")
    if (lock, os.getpid()) in _held:
        return None
    mine = json.dumps({"process": os.getpid(), "started": _started(os.getpid()), **_machine()})
    with naming(path):
        patience = time.monotonic() + PATIENCE
        while not (_created(lock, mine) and _read(lock) == mine):
            there = _read(lock)
            if there:
                _check_gone(there, lock)
            if (there or time.monotonic() > patience) and _removed(lock, there):
                patience = time.monotonic() + PATIENCE
            elif time.monotonic() > 2 * PATIENCE + patience:
                raise InputError(f"{lock} was left by a run that was killed; remove it, and {_ticket(lock)}")
            time.sleep(0.01)
    _held.add((lock, os.getpid()))
    _beside(path, "turn").unlink(missing_ok=True)  # left by a run that was killed
    return lock


def _ticket(lock: Path) -> Path:
    return lock.with_name(f"{lock.name}.stale")


def _removed(lock: Path, content: str | None) -> bool:
    """Remove an invalid claim, unless another process is removing it."""
    ticket = _ticket(lock)  # only its owner removes the claim, and only if the content is the same
    if content is None or not _created(ticket, ""):
        return False
    try:
        if _read(lock) == content:
            lock.unlink()
    finally:
        ticket.unlink()
    return True


def _created(file: Path, content: str) -> bool:
    """Create ``file``; False if it exists."""
    try:
        with open(file, "xb") as new:  # links are not followed
            new.write(content.encode())
    except FileExistsError:
        return False
    return True


def _read(lock: Path) -> str | None:
    """Return the content of a claim; None if it does not exist."""
    try:
        with open(os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                return file.read(4096).decode(errors="replace")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{lock} is not a claim of petscjam ({error.strerror}); remove it") from None
    raise InputError(f"{lock} is not a claim of petscjam; remove it")


def _check_gone(content: str, lock: Path) -> None:
    """Raise an error if the process of a claim may still be running."""
    try:
        owner = json.loads(content)
        process, host, started = int(owner["process"]), str(owner["host"]), owner["started"]
        here = all(owner[key] == value for key, value in _machine().items())
    except (ValueError, LookupError, TypeError):
        raise InputError(f"{lock} is not a claim of petscjam; remove it") from None
    if not here or _is_alive(process, started):
        advice = "" if here else f"; if it has ended, remove {lock}"
        raise InputError(f"another run (process {process} on {host}) writes to it{advice}")


def _machine() -> dict[str, str]:
    """Return the scope of process numbers: the host, and the container on it."""
    namespace = "/proc/self/ns/pid"
    return {"host": socket.gethostname(), "in": os.readlink(namespace) if os.path.exists(namespace) else ""}


def _is_alive(process: int, started: str | None) -> bool:
    """Return whether there is a process with this number and this start time."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return _started(process) in (started, None)


def _started(process: int) -> str | None:
    """Return the start time of a process, in ticks since the start of the machine; None if it is unknown."""
    try:
        state, *values = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return "ended" if state in "ZX" else values[18]
