"""Standard output and standard error: what cannot be written to them ends no computation."""

from __future__ import annotations

import errno
import os
from typing import Any


class Stream:
    """A text stream that replaces what its encoding lacks, and goes on where nothing more can be written.

    Attributes
    ----------
    error : OSError or None
        Why something was not written; a reader that has gone away is no error.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = open(os.devnull, "w") if stream is None else stream  # noqa: SIM115
        self.error: OSError | None = None
        if getattr(self._stream, "errors", None) == "strict":
            self._stream.reconfigure(errors="replace")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, as far as that is possible."""
        try:
            self._stream.write(text)
        except OSError as error:
            self._leave(error)
        return len(text)

    def flush(self) -> None:
        """Flush, as far as that is possible."""
        try:
            self._stream.flush()
        except OSError as error:
            self._leave(error)

    def _leave(self, error: OSError) -> None:
        """Let this text, kept by Python, and all that follows go nowhere."""
        if error.errno != errno.EPIPE:
            self.error = self.error or error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)
