"""Meaningless bytes on the line of a board of the load, between the frames of the board.

python flood.py FD BYTES_PER_S   (0: as many as the line takes)
"""

import os
import sys
import time

QUIET_S = 15.0  # until a session has accepted the board
PIECE = bytes(range(256)) * 4  # has every byte, and so each delimiter
MAX_LATE_S = 0.1  # a longer pause is not made up for
FULL_WAIT_S = 0.001


def flood(fd: int, bytes_per_s: float) -> None:
    """Send until the process is ended."""
    next_s = time.monotonic()
    while True:
        try:
            count = os.write(fd, PIECE)
        except BlockingIOError:  # the board has made its line non-blocking
            time.sleep(FULL_WAIT_S)
            continue
        if bytes_per_s:
            now_s = time.monotonic()
            next_s = max(next_s + count / bytes_per_s, now_s - MAX_LATE_S)
            time.sleep(max(0.0, next_s - now_s))


if __name__ == "__main__":
    time.sleep(QUIET_S)
    flood(int(sys.argv[1]), float(sys.argv[2]))
