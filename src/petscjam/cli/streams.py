"""Standard output and standard error: an error of writing to them does not end a computation."""

from __future__ import annotations

import errno
import os
from typing import Any


class Stream:
    """A text stream that replaces characters that its encoding lacks, and continues after an error of writing.

    Attributes
    ----------
    error : OSError or None
        Why text was not written; a closed pipe is not an error.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = open(os.devnull, "w") if stream is None else stream  # noqa: SIM115
        self.error: OSError | None = None
        if getattr(self._stream, "errors", None) == "strict":
            self._stream.reconfigure(errors="replace")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, if possible."""
        try:
            self._stream.write(text)
        except OSError as error:
            self._leave(error)
        return len(text)

    def flush(self) -> None:
        """Flush, if possible."""
        try:
            self._stream.flush()
        except OSError as error:
            self._leave(error)

    def _leave(self, error: OSError) -> None:
        """Discard this text, which Python keeps in its buffer, and all further text."""
        if error.errno != errno.EPIPE:
            self.error = self.error or error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)
