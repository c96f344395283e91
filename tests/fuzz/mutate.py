"""Random mutation of seeds, for computers without a coverage-guided fuzzer."""

import random
from collections.abc import Sequence

WORDS = (
    b"\0", b"\xff", b"\n", b"\r\n", b"!", b"!P", b"*", b" ", b":", b"- ", b"{", b"[", b"&a", b"*a",
    b"!!python/object:os.system", b"\x80", b"-1", b"1e999", b"0x", b"99999999999999999999", b"nan",
)  # fmt: skip


def mutate(chance: random.Random, seeds: Sequence[bytes], longest: int) -> bytes:
    """Return a seed with one to eight changes, at most `longest` bytes."""
    data = bytearray(chance.choice(seeds) if seeds else b"")
    for _ in range(chance.randint(1, 8)):
        index = chance.randrange(len(data) + 1)
        end = min(len(data), index + chance.randint(1, 16))
        match chance.randrange(7):
            case 0:
                data[index:index] = chance.randbytes(chance.randint(1, 8))
            case 1:
                del data[index:end]
            case 2:
                data[index:end] = chance.randbytes(end - index)
            case 3:
                data[index:index] = data[index:end] * chance.randint(1, 4)
            case 4:
                data[index:index] = chance.choice(WORDS)
            case 5 if data:
                data[index % len(data)] ^= 1 << chance.randrange(8)
            case _:
                other = chance.choice(seeds) if seeds else b""
                data[index:] = other[chance.randrange(len(other) + 1) :]
    return bytes(data[:longest])
