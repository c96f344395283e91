"""Cut a stream at a delimiter byte, with bounded memory and independent of the reads."""


class PieceSplitter:
    """Collect the bytes between two delimiters, up to a limit.

    A piece beyond the limit comes out once, cut off one byte past the limit, at the read
    that made it too long; the rest of it is dropped up to the next delimiter.
    """

    def __init__(self, delimiter: bytes, max_piece_bytes: int) -> None:
        self._delimiter = delimiter
        self._limit = max_piece_bytes
        self._tail = b""
        self._skipping = False

    @property
    def buffered_bytes(self) -> int:
        """How much of an unfinished piece is held, at most the limit."""
        return len(self._tail)

    def reset(self) -> None:
        """Forget an unfinished piece."""
        self._tail = b""
        self._skipping = False

    def feed(self, data: bytes) -> list[tuple[bytes, int]]:
        """Return the pieces that `data` completes, each with the place in `data` of its end.

        Returns:
            Pieces without the delimiter; one longer than the limit was overlong.
        """
        pieces: list[tuple[bytes, int]] = []
        *ended, tail = data.split(self._delimiter)
        at = 0
        for part in ended:
            at += len(part)
            if self._skipping:
                self._skipping = False
            else:
                pieces.append(((self._tail + part)[: self._limit + 1], at))
                self._tail = b""
            at += 1
        if not self._skipping:
            self._tail += tail
            if len(self._tail) > self._limit:
                pieces.append((self._tail[: self._limit + 1], len(data) - 1))
                self._tail = b""
                self._skipping = True
        return pieces
