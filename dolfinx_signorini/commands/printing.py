"""Standard output whose failure costs no result."""

import os
import sys
from typing import TextIO


class Guarded:
    """A stream that remembers why nothing can be written to it, and takes what is printed on.

    A full disk or a reader who has gone must not end a long run before its files are written:

        sys.stdout = Guarded(sys.stdout)
        ...
        sys.stdout.flush()
        print(sys.stdout.failure, file=sys.stderr)

    Args:
        stream: Standard output.

    Attributes:
        failure: Why the stream could not be written, in words; "" as long as it could.
    """

    def __init__(self, stream: TextIO):
        self._stream = stream
        self.failure = ""

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, and return its length."""
        if not self.failure:
            try:
                self._stream.write(text)
            except OSError as error:
                self._fail(error)
            except UnicodeEncodeError as error:  # a title may have what a terminal has not
                encoded = text.encode(error.encoding, "backslashreplace")
                return self.write(encoded.decode(error.encoding))
        return len(text)

    def flush(self) -> None:
        """Write what waits to be written."""
        if not self.failure:
            try:
                self._stream.flush()
            except OSError as error:
                self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.failure = error.strerror or str(error)
        if self._stream is sys.__stdout__:  # the interpreter flushes it once more at its end
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
