"""The two ways in which petscjam refuses: bad input, and a computation that cannot be trusted."""


class InputError(ValueError):
    """Something the user gave is wrong; the message names the value and what to do. Exit status 2."""


class SolverError(RuntimeError):
    """A solve failed or its result cannot be trusted; the message says why. Exit status 1."""
