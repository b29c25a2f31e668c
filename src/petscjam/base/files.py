"""Files that are whole or absent: atomic writing, and reading with error messages that name the fault.

The HDF5 library does not write to the disk. A file is built in memory, and Python writes its bytes to a temporary
file and renames it. So neither a kill nor a full disk leaves an incomplete file, an error of the disk is an
OSError at a known place, a parallel build of h5py behaves like a serial one, and the file system needs no locks.

The bytes of HDF5 are followed by their digest (:data:`MARK` and 32 bytes, BLAKE2b), which the HDF5 library
ignores. It is compared before HDF5 reads a file, because a single wrong bit can change a number or make HDF5
hang. A file that another program has written or changed has no digest.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from hashlib import blake2b
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from petscjam.base.errors import InputError, MissingError

if TYPE_CHECKING:
    import h5py

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
MARK, DIGEST = b"petscjam blake2b", 32  # before the digest, and the length of the digest
PIECE = 2**20  # bytes read at a time
ROOM = 24  # additional bytes in the name of a temporary file
FREE, RATIO = 2**26, 1000  # bytes that a dataset may have without being stored; largest factor of compression
TYPES = {  # annotations of dataclasses: kinds of NumPy, and whether it is an array
    "Array": ("f", True),
    "Integers": ("iu", True),
    "NDArray[np.int64]": ("iu", True),
    "NDArray[np.complex128]": ("c", True),
    "Complex": ("c", True),
    "NDArray[np.bool_]": ("b", True),
    "tuple[float, float]": ("f", True),
    "tuple[float, ...]": ("f", True),
    "float": ("fiu", False),
    "int": ("iu", False),
    "bool": ("b", False),
    "str": ("U", False),
}
VERSIONS = ("v108", "latest")  # H5MD recommends version 2 of the file format: metadata have checksums


@contextmanager
def understanding(what: str) -> Iterator[None]:
    """Turn any error in the block, which decodes a file, into an InputError. The block must only decode."""
    try:
        yield
    except InputError:
        raise
    except (
        OSError,
        RuntimeError,
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        ArithmeticError,
        AssertionError,
        MemoryError,
    ) as error:
        raise InputError(f"damaged {what}, or not the expected content ({error})") from None


@contextmanager
def naming(path: str | PathLike[str]) -> Iterator[None]:
    """Turn an OSError into an InputError, and add ``path`` to the message of every InputError."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(f"{path}:"):
            raise
        kind = MissingError if isinstance(error, MissingError) else InputError
        raise kind(f"{path}: {error}") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None


def check_output(path: str | PathLike[str], *, overwrite: bool, inputs: Iterable[str | PathLike[str]] = ()) -> None:
    """Refuse a ``path`` that cannot be written at the end of the computation, or must not be written.

    Parameters
    ----------
    path : str or PathLike
    overwrite : bool
    inputs : iterable of paths
        Files that the computation reads.

    Raises
    ------
    InputError
        If it exists and ``overwrite`` is not set, is a folder, a device or one of ``inputs``; or as
        :func:`check_folder`.
    """
    for reason, refused in (
        ("is a folder, not a file", os.path.isdir(path)),
        ("is a device or a pipe, not a file", os.path.exists(path) and not os.path.isfile(path)),
        ("is an input, too; choose another name", any(_same(path, name) for name in inputs)),
        ("exists already; choose another name or ask to overwrite it", os.path.exists(path) and not overwrite),
    ):
        if refused:
            raise InputError(f"{path}: {reason}")
    check_folder(path)


def check_folder(path: str | PathLike[str]) -> None:
    """Refuse a ``path`` that cannot be written in its folder, or in the folder of its target if it is a link.

    Raises
    ------
    InputError
        If its folder is missing or not writable, or its name is too long.
    """
    target = Path(os.path.realpath(path))
    folder = target.parent
    if target.is_symlink():  # realpath stops here
        raise InputError(f"{path}: is a link that points to itself")
    if not folder.is_dir():
        raise InputError(f"{path}: there is no folder {folder}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the folder {folder} is not writable")
    most = os.pathconf(folder, "PC_NAME_MAX") - ROOM
    if len(os.fsencode(target.name)) > most:
        raise InputError(f"{path}: the name is too long; in this folder it may have {most} bytes")


def _same(a: str | PathLike[str], b: str | PathLike[str]) -> bool:
    return os.path.exists(a) and os.path.exists(b) and os.path.samefile(a, b)


def write_atomically(path: str | PathLike[str], data: bytes) -> None:
    """Replace the file at ``path`` by ``data``, completely or not at all; its permissions stay.

    If it has other names (hard links), it is overwritten in place, while a complete copy exists in the same folder.

    Parameters
    ----------
    path : str or PathLike
    data : bytes

    Raises
    ------
    InputError
        If the disk is full, the folder is missing or not writable, ….
    """
    target = Path(os.path.realpath(path))  # a link remains a link
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    with naming(path):
        try:
            temporary.unlink(missing_ok=True)  # of a process that was killed
            with open(temporary, "xb") as file:  # links are not followed
                if target.exists():
                    with suppress(OSError):
                        os.fchmod(file.fileno(), stat.S_IMODE(target.stat().st_mode))
                _write_through(file, data)
            if not target.exists() or target.stat().st_nlink == 1:
                os.replace(temporary, target)
                return
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
        with naming(f"{path}: cannot be overwritten; the complete file is {temporary}"), open(target, "r+b") as file:
            _write_through(file, data)
            file.truncate()
        temporary.unlink()


def _write_through(file: BinaryIO, data: bytes) -> None:
    """Write to the disk, not only to the cache of the system."""
    file.write(data)
    file.flush()
    os.fsync(file.fileno())


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
            data = Path(path).read_bytes()
        memory = BytesIO(data[: -len(MARK) - DIGEST] if _mark(BytesIO(data)) else data)
    with h5py.File(memory, "r+", libver=VERSIONS) if existing else _new_h5(memory) as file:
        yield file
    data = memory.getvalue()
    write_atomically(path, data + MARK + blake2b(data, digest_size=DIGEST).digest())


def group(parent: h5py.Group, path: str) -> h5py.Group:
    """Return the group at ``path``, made if necessary. It stores no time: equal content gives equal bytes.

    Parameters
    ----------
    parent : h5py.Group
    path : str
        Names separated by ``/``.
    """
    import h5py

    timeless = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
    timeless.set_obj_track_times(False)
    for name in path.split("/"):
        there = name in parent
        parent = parent[name] if there else h5py.Group(h5py.h5g.create(parent.id, name.encode(), gcpl=timeless))
    return parent


def _new_h5(memory: BytesIO) -> h5py.File:
    """Do what h5py.File does, but store no time of the root group."""
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
        If the file is missing or not HDF5, or if the block raises an error on its content. The path is put before
        the message of an InputError of the block. The block must only decode.
    """
    import h5py

    with naming(path), open(path, "rb") as raw:
        if raw.read(len(HDF5_SIGNATURE)) != HDF5_SIGNATURE:
            raise InputError("not an HDF5 file")
        ours = _mark(raw)
        if ours and not _is_whole(raw):
            raise InputError("damaged: its bytes are not those that were written (the digest differs)")
        with understanding("HDF5 file"), h5py.File(raw, "r") as file:
            if not ours:
                _check_sizes(file, os.path.getsize(path))
            yield file


def check_type(name: str, value: object, annotation: str) -> None:
    """Refuse a ``value`` of another type than the annotation of a dataclass; None and unknown types are accepted.

    Parameters
    ----------
    name : str
        Of the field, for the message.
    value : object
    annotation : str
        Type of the field, a key of ``TYPES``, with or without ``| None``.

    Raises
    ------
    InputError
        If it has another type.
    """
    import numpy as np

    kinds, array = TYPES.get(annotation.removesuffix(" | None"), ("", True))
    if value is None or not kinds:
        return
    found = np.asarray(value)
    if found.dtype.kind not in kinds or (found.ndim > 0) != array:
        what = f"an array of {found.dtype}" if found.ndim else type(value).__name__
        wanted = re.sub(r"NDArray\[np\.([a-z]+\d*)_?\]", r"an array of \1", annotation)
        raise InputError(f"{name} is {what}, not {wanted}")


def check_shapes(where: str, shapes: Mapping[str, str], values: Mapping[str, Any]) -> None:
    """Refuse arrays from a file that do not fit together.

    Parameters
    ----------
    where : str
        Their name in a message.
    shapes : mapping
        The axes of each array by its name, as ``"W 2"``: equal letters mean equal lengths, above 0 except for F
        and C.
    values : mapping
        The arrays; None is accepted.

    Raises
    ------
    InputError
        If one has another shape.
    """
    import numpy as np

    lengths: dict[str, int] = {}
    for name, text in shapes.items():
        if values[name] is None:
            continue
        axes, shape = text.split(), np.shape(values[name])
        wanted = [int(a) if a.isdigit() else lengths.get(a) for a in axes]
        if len(shape) != len(axes) or any(w not in (n, None) for n, w in zip(shape, wanted, strict=True)):
            raise InputError(f"{where}: {name} has the shape {shape}, not ({', '.join(axes)})")
        if 0 in shape and not {"F", "C"} & {*axes}:
            raise InputError(f"{where}: {name} is empty")
        lengths.update(zip(axes, shape, strict=True))


def h5_format(path: str | PathLike[str]) -> str | None:
    """Return the attribute ``format`` of an HDF5 file; files of petscjam have it, except packings.

    Raises
    ------
    InputError
        If the file is missing or damaged.
    """
    with naming(path), open(path, "rb") as raw:
        if raw.read(len(HDF5_SIGNATURE)) != HDF5_SIGNATURE:
            return None
    with open_h5(path) as file:
        return marked(file)[0]


def marked(h5: h5py.Group) -> tuple[str | None, int | None]:
    """Return the attributes ``format`` and ``schema`` of an open file; None if absent, or of another type."""
    import numpy as np

    kind, schema = (h5.attrs.get(name) for name in ("format", "schema"))
    whole = isinstance(schema, int | np.integer) and not isinstance(schema, bool)
    return kind if isinstance(kind, str) else None, int(schema) if whole else None


def _mark(raw: BinaryIO) -> bool:
    """Return whether there is a digest at the end."""
    length = raw.seek(0, os.SEEK_END)
    raw.seek(max(0, length - len(MARK) - DIGEST))
    return raw.read(len(MARK)) == MARK


def _is_whole(raw: BinaryIO) -> bool:
    """Return whether the bytes before the digest have this digest."""
    left = raw.seek(0, os.SEEK_END) - len(MARK) - DIGEST
    found = blake2b(digest_size=DIGEST)
    raw.seek(0)
    while piece := raw.read(min(PIECE, left)):
        found.update(piece)
        left -= len(piece)
    raw.seek(-DIGEST, os.SEEK_END)
    return raw.read() == found.digest()


def _check_sizes(file: h5py.File, length: int) -> None:
    """Refuse datasets that are larger than a file of ``length`` bytes can contain."""
    import h5py

    def check(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Dataset) and node.size:
            stored = min(length, node.id.get_storage_size())
            asked, held = node.size * node.dtype.itemsize, stored * (RATIO if node.chunks else 1)
            if asked > FREE + held:
                raise InputError(f"{name} needs {asked:.2g} bytes, but the file has {length}: damaged")

    file.visititems(check)
