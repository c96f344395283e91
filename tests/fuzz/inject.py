"""Fault injection: count the wrong samples from a damaged serial line, by kind of fault.

A damaged frame is sent between two valid ones. A received sample that was not sent is wrong.
`make fuzz` runs a million faults of each kind (`--faults`).
"""

# ruff: noqa: T201 - a program that prints a table
import argparse
import json
import random
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from gyrorig_protocol.board import Batch, FrameEvent, FrameParser, Sample

Damage = Callable[[random.Random, bytearray], None]


def flip_bits(chance: random.Random, frame: bytearray) -> None:
    """Flip one to three bits anywhere in the frame."""
    for _ in range(chance.randint(1, 3)):
        frame[chance.randrange(len(frame))] ^= 1 << chance.randrange(8)


def flip_burst(chance: random.Random, frame: bytearray) -> None:
    """Flip bits in a burst of up to 16 bits."""
    width = chance.randint(2, 16)
    index = chance.randrange(len(frame) * 8 - width)
    pattern = chance.getrandbits(width) | 1 | 1 << (width - 1)
    for bit in range(width):
        if pattern >> bit & 1:
            frame[(index + bit) // 8] ^= 1 << (index + bit) % 8


def drop_byte(chance: random.Random, frame: bytearray) -> None:
    """Drop a byte."""
    del frame[chance.randrange(len(frame))]


def insert_byte(chance: random.Random, frame: bytearray) -> None:
    """Insert a byte."""
    frame.insert(chance.randrange(len(frame) + 1), chance.randrange(256))


def repeat_byte(chance: random.Random, frame: bytearray) -> None:
    """Repeat a byte."""
    index = chance.randrange(len(frame))
    frame.insert(index, frame[index])


def drop_bytes(chance: random.Random, frame: bytearray) -> None:
    """Drop up to 20 consecutive bytes, as a full receive buffer does."""
    index = chance.randrange(len(frame))
    del frame[index : index + chance.randint(2, 20)]


def randomise(chance: random.Random, frame: bytearray) -> None:
    """Replace all bytes except the delimiters; no checksum detects every such fault."""
    frame[1:-1] = bytes(chance.randint(1, 255) for _ in frame[1:-1])


KINDS: dict[str, Damage] = {
    "1 to 3 bits": flip_bits,
    "burst of up to 16 bits": flip_burst,
    "a byte lost": drop_byte,
    "a byte more": insert_byte,
    "a byte twice": repeat_byte,
    "2 to 20 bytes lost": drop_bytes,
    "all bytes random": randomise,
}


def sample(chance: random.Random, number: int) -> Sample:
    """Return a realistic sample with a unique number."""
    x, y, z, a, b, c = (chance.randint(-400, 400) for _ in range(6))
    return Sample(4, number & 0xFFFF, number * 1250 & 0xFFFF_FFFF, (x, y, z), (a, b, c), -5)


def inject(damage: Damage, faults: int, seed: str) -> dict[str, int]:
    """Return the results of damaged frames between valid ones."""
    chance, parser = random.Random(seed), FrameParser()
    wrong = through = lost_neighbours = 0
    for number in range(0, 3 * faults, 3):
        sent = [sample(chance, number + k) for k in range(3)]
        bad = bytearray(sent[1].encode())
        damage(chance, bad)
        events = parser.feed(sent[0].encode() + bytes(bad) + sent[2].encode(), 1)
        samples = [
            event.frame
            for event in events
            if isinstance(event, FrameEvent) and isinstance(event.frame, Sample | Batch)
        ]
        wrong += sum(frame not in sent for frame in samples)
        through += sent[1] in samples  # the damage hit a delimiter, which is present twice
        lost_neighbours += (sent[0] not in samples) + (sent[2] not in samples)
    return {
        "faults": faults,
        "wrong": wrong,
        "harmless": through,
        "neighbours_lost": lost_neighbours,
    }


def main() -> int:
    """Print the table; return 1 if a fault that must be detected gave a wrong sample."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=1_000_000, help="of each kind")
    parser.add_argument("--out", type=Path, help="write the figures here (JSON)")
    options = parser.parse_args()
    table = {}
    for name, damage in KINDS.items():
        begun = time.monotonic()
        table[name] = inject(damage, options.faults, f"gyrorig {name}")
        row = table[name]
        print(
            f"{name:24}{row['faults']:>9} faults {row['wrong']:>4} wrong samples "
            f"{row['neighbours_lost']:>6} valid neighbours lost  {time.monotonic() - begun:5.0f} s",
            flush=True,
        )
    if options.out is not None:
        options.out.write_text(json.dumps(table, indent=1) + "\n")
    sure = [row["wrong"] for name, row in table.items() if "random" not in name]
    return int(any(sure))


if __name__ == "__main__":
    sys.exit(main())
