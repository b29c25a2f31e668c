"""Files that are whole or absent: atomic writing, and reading that says what is wrong.

HDF5 never touches the disk here. A file is built in memory and its bytes are moved into place by
plain Python, so neither a kill nor a full disk leaves half a file, an error of the disk surfaces as
an OSError at a known place, and a parallel build of h5py behaves as a serial one.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from petscjam.errors import InputError

if TYPE_CHECKING:
    import h5py

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
VERSIONS = ("v108", "latest")  # H5MD recommends version 2 of the file format: metadata have checksums


@contextmanager
def naming(path: str | PathLike[str]) -> Iterator[None]:
    """Turn an OSError into an InputError, and see that every InputError names ``path``."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(f"{path}:"):
            raise
        raise InputError(f"{path}: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error


def check_output(
    path: str | PathLike[str], *, overwrite: bool, inputs: Iterable[str | PathLike[str]] = ()
) -> None:
    """Refuse a ``path`` that could not be written at the end of the work, or should not be.

    Raises
    ------
    InputError
        If it exists and ``overwrite`` is not set, is a folder or one of ``inputs``, or lies in a folder
        that is missing or not writable.
    """
    folder = Path(path).absolute().parent
    for reason, refused in (
        ("is a folder, not a file", os.path.isdir(path)),
        ("is an input, too; choose another name", any(_same(path, name) for name in inputs)),
        (
            "exists already; choose another name or ask to overwrite it",
            os.path.exists(path) and not overwrite,
        ),
        (f"there is no folder {folder}", not folder.is_dir()),
        (f"the folder {folder} is not writable", folder.is_dir() and not os.access(folder, os.W_OK)),
    ):
        if refused:
            raise InputError(f"{path}: {reason}")


def _same(a: str | PathLike[str], b: str | PathLike[str]) -> bool:
    return os.path.exists(a) and os.path.exists(b) and os.path.samefile(a, b)


def release(package: str) -> str:
    """Return the version of an installed package, or ``unknown``."""
    try:
        return version(package)
    except PackageNotFoundError:  # run from a source tree
        return "unknown"


def write_atomically(path: str | PathLike[str], data: bytes) -> None:
    """Replace the file at ``path`` by ``data``, wholly or not at all.

    Raises
    ------
    InputError
        If the disk is full, the folder is missing or not writable, ….
    """
    target = Path(os.path.realpath(path))  # a link stays a link
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    with naming(path):
        try:
            with open(temporary, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, target)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise


@contextmanager
def locked(path: str | PathLike[str]) -> Iterator[None]:
    """Keep other processes that ask for the same ``path`` waiting while it is read, changed and replaced."""
    import fcntl

    with naming(path), open(_lock_of(path), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def unlock(path: str | PathLike[str]) -> None:
    """Remove what :func:`locked` leaves behind, once nobody uses it any more."""
    _lock_of(path).unlink(missing_ok=True)


def _lock_of(path: str | PathLike[str]) -> Path:
    target = Path(os.path.realpath(path))
    return target.with_name(f".{target.name}.lock")


@contextmanager
def atomic_h5(path: str | PathLike[str], existing: bool = False) -> Iterator[h5py.File]:
    """Yield an HDF5 file in memory; write it to ``path`` when the block ends without an error.

    Parameters
    ----------
    path : path
    existing : bool
        Start from the contents of the file at ``path`` instead of an empty file.

    Raises
    ------
    InputError
        If the file cannot be written, or ``existing`` and it cannot be read. ``path`` is then as before.
    """
    import h5py

    memory = BytesIO()
    if existing:
        with open_h5(path):
            memory = BytesIO(Path(path).read_bytes())
    with h5py.File(memory, "r+", libver=VERSIONS) if existing else _new_h5(memory) as file:
        yield file
    write_atomically(path, memory.getvalue())


def group(parent: h5py.Group, path: str) -> h5py.Group:
    """Return the group at ``path``, made if need be. It keeps no time: the same content, the same bytes."""
    import h5py

    timeless = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
    timeless.set_obj_track_times(False)
    for name in path.split("/"):
        there = name in parent
        parent = (
            parent[name] if there else h5py.Group(h5py.h5g.create(parent.id, name.encode(), gcpl=timeless))
        )
    return parent


def _new_h5(memory: BytesIO) -> h5py.File:
    """Do what h5py.File does, but keep no time of the root group."""
    import h5py

    timeless, access = h5py.h5p.create(h5py.h5p.FILE_CREATE), h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    timeless.set_obj_track_times(False)
    access.set_fclose_degree(h5py.h5f.CLOSE_STRONG)
    access.set_libver_bounds(h5py.h5f.LIBVER_V18, h5py.h5f.LIBVER_LATEST)
    access.set_fileobj_driver(h5py.h5fd.fileobj_driver, memory)
    return h5py.File(h5py.h5f.create(b"memory", h5py.h5f.ACC_TRUNC, fcpl=timeless, fapl=access))


@contextmanager
def open_h5(path: str | PathLike[str]) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading, through Python's own I/O (no locks, no MPI).

    Raises
    ------
    InputError
        If the file is missing or not HDF5, or if the block stumbles over what it reads. An InputError
        raised in the block gets the path in front of its message. So only decode in the block.
    """
    import h5py

    with naming(path), open(path, "rb") as raw:
        if raw.read(8) != HDF5_SIGNATURE:
            raise InputError("not an HDF5 file")
        try:
            with h5py.File(raw, "r") as file:
                yield file
        except InputError:
            raise
        except (OSError, RuntimeError, LookupError, TypeError, ValueError, MemoryError) as error:
            raise InputError(f"damaged HDF5 file, or not the expected content ({error})") from error
