"""Split a byte stream at a delimiter, with bounded memory, independent of the read calls."""


class DelimiterSplitter:
    """Collect the bytes between two delimiters, up to a limit.

    A piece that exceeds the limit is returned once, cut to one byte more than the limit, at the
    read call that made it too long. The rest of it is dropped up to the next delimiter.
    """

    def __init__(self, delimiter: bytes, max_piece_bytes: int) -> None:
        self._delimiter = delimiter
        self._max_piece_bytes = max_piece_bytes
        self._tail = b""
        self._skipping = False

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes of an unfinished piece, at most the limit."""
        return len(self._tail)

    def reset(self) -> None:
        """Drop an unfinished piece."""
        self._tail = b""
        self._skipping = False

    def feed(self, data: bytes) -> list[tuple[bytes, int]]:
        """Return the pieces that `data` completes, each with the position of its end in `data`.

        Returns:
            Pieces without the delimiter; a piece longer than the limit was too long.
        """
        pieces: list[tuple[bytes, int]] = []
        *complete_parts, rest = data.split(self._delimiter)
        position = 0
        for part in complete_parts:
            position += len(part)
            if self._skipping:
                self._skipping = False
            else:
                pieces.append(((self._tail + part)[: self._max_piece_bytes + 1], position))
                self._tail = b""
            position += 1
        if not self._skipping:
            self._tail += rest
            if len(self._tail) > self._max_piece_bytes:
                pieces.append((self._tail[: self._max_piece_bytes + 1], len(data) - 1))
                self._tail = b""
                self._skipping = True
        return pieces
