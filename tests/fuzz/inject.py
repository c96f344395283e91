"""How many wrong samples a damaged line gives: faults by kind, by the million.

A damaged frame stands between two sound ones. What comes out is compared with what went
in: a sample that nobody sent is a wrong one. `make fuzz` runs it; `--faults` per kind.
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


def flipped(chance: random.Random, frame: bytearray) -> None:
    """Turn one to three bits over, anywhere in the frame."""
    for _ in range(chance.randint(1, 3)):
        frame[chance.randrange(len(frame))] ^= 1 << chance.randrange(8)


def burst(chance: random.Random, frame: bytearray) -> None:
    """Spoil up to 16 bits in a row."""
    width = chance.randint(2, 16)
    at = chance.randrange(len(frame) * 8 - width)
    pattern = chance.getrandbits(width) | 1 | 1 << (width - 1)
    for bit in range(width):
        if pattern >> bit & 1:
            frame[(at + bit) // 8] ^= 1 << (at + bit) % 8


def dropped(chance: random.Random, frame: bytearray) -> None:
    """Lose a byte."""
    del frame[chance.randrange(len(frame))]


def inserted(chance: random.Random, frame: bytearray) -> None:
    """Slip a byte in."""
    frame.insert(chance.randrange(len(frame) + 1), chance.randrange(256))


def doubled(chance: random.Random, frame: bytearray) -> None:
    """Say a byte twice."""
    at = chance.randrange(len(frame))
    frame.insert(at, frame[at])


def overrun(chance: random.Random, frame: bytearray) -> None:
    """Lose up to 20 bytes in a row, as a full receive buffer does."""
    at = chance.randrange(len(frame))
    del frame[at : at + chance.randint(2, 20)]


def rewritten(chance: random.Random, frame: bytearray) -> None:
    """Put chance in the place of all but the borders: what no check can be sure to see."""
    frame[1:-1] = bytes(chance.randint(1, 255) for _ in frame[1:-1])


KINDS: dict[str, Damage] = {
    "1 to 3 bits": flipped,
    "burst of up to 16 bits": burst,
    "a byte lost": dropped,
    "a byte more": inserted,
    "a byte twice": doubled,
    "2 to 20 bytes lost": overrun,
    "all bytes by chance": rewritten,
}


def sample(chance: random.Random, number: int) -> Sample:
    """Return a sample as a gyro at work sends it, different from all others by its number."""
    x, y, z, a, b, c = (chance.randint(-400, 400) for _ in range(6))
    return Sample(4, number & 0xFFFF, number * 1250 & 0xFFFF_FFFF, (x, y, z), (a, b, c), -5)


def inject(damage: Damage, faults: int, seed: str) -> dict[str, int]:
    """Return what came of so many damaged frames between sound ones."""
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
        through += sent[1] in samples  # the damage hit a border, which is there twice
        lost_neighbours += (sent[0] not in samples) + (sent[2] not in samples)
    return {
        "faults": faults,
        "wrong": wrong,
        "harmless": through,
        "neighbours_lost": lost_neighbours,
    }


def main() -> int:
    """Print the table; return 1 where a wrong sample came of a fault that must be seen."""
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
            f"{row['neighbours_lost']:>6} sound neighbours lost  {time.monotonic() - begun:5.0f} s",
            flush=True,
        )
    if options.out is not None:
        options.out.write_text(json.dumps(table, indent=1) + "\n")
    sure = [row["wrong"] for name, row in table.items() if "chance" not in name]
    return int(any(sure))


if __name__ == "__main__":
    sys.exit(main())
