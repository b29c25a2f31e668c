"""The kinds of errors: wrong input, a missing package, and a computation whose result is not reliable."""


class InputError(ValueError):
    """An input is wrong; the message names the value and what to do. Exit status 2."""


class MissingError(InputError, ImportError):
    """A package is not installed; the message names what installs it. Exit status 2."""


class SolverError(RuntimeError):
    """A solve failed or its result is not reliable; the message gives the reason. Exit status 1."""


class DoubtfulWarning(UserWarning):
    """There is a result, but its numbers may be inaccurate."""


def shown(value: object) -> str:
    """Return ``repr(value)`` with Python's numbers for NumPy's, for a message: 1.4, not np.float64(1.4)."""
    if isinstance(value, tuple):
        return f"({', '.join(map(shown, value))})"
    return repr(value.tolist() if hasattr(value, "tolist") else value)


def readable(name: str) -> str:
    """Return the name of a file with ? for bytes that are not UTF-8, which HDF5 cannot store."""
    return name.encode(errors="replace").decode()
