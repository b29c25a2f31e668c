"""The two ways in which petscjam refuses: bad input, and a computation that cannot be trusted."""


class InputError(ValueError):
    """Something the user gave is wrong; the message names the value and what to do. Exit status 2."""


class SolverError(RuntimeError):
    """A solve failed or its result cannot be trusted; the message says why. Exit status 1."""


class DoubtfulWarning(UserWarning):
    """A result is there, but its numbers are doubtful."""


def shown(value: object) -> str:
    """Return ``repr(value)`` with Python's numbers for NumPy's, for a message: 1.4, not np.float64(1.4)."""
    if isinstance(value, tuple):
        return f"({', '.join(map(shown, value))})"
    return repr(value.tolist() if hasattr(value, "tolist") else value)


def readable(name: str) -> str:
    """Return the name of a file with ? for bytes that are no text: neither HDF5 nor UTF-8 can keep them."""
    return name.encode(errors="replace").decode()
