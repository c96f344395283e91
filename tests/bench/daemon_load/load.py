"""Sixteen boards in one small program: eight on pseudo-terminals, eight on two CAN buses.

Four gyroscope boards of 800 Hz load a CAN bus of 1 Mbit/s to 40 %: eight on one would be
80 %, and a frame then waits for several others before it is sent.
"""

import os
import socket
import subprocess
import tty
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parents[2] / "firmware_protocol" / "firmware" / "src"
GROUP = "239.74.163.9"
SERIAL_BOARDS, BUSES, NODES = 8, 2, 4


def build(folder: Path) -> tuple[Path, Path]:
    """Compile the load and the slow disk; return their paths."""
    program, disk = folder / "many_boards", folder / "slow_disk.so"
    strict: list[str | Path] = [
        "gcc",
        "-std=gnu11",
        "-O2",
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-I{FIRMWARE}",
    ]
    boards: list[str | Path] = [HERE / "many_boards.c", FIRMWARE / "gyrorig_board.c"]
    subprocess.run([*strict, "-o", program, *boards], check=True)
    shared: list[str | Path] = ["-shared", "-fPIC", "-o", disk, HERE / "slow_disk.c", "-ldl"]
    subprocess.run([*strict, *shared], check=True)
    return program, disk


@dataclass(frozen=True)
class BoardCounts:
    """Counts of a board, which it reports at the end."""

    samples: int
    dropped: int  # frames that its line did not accept
    lost: int  # before it sent them, because the load's program was stalled for a second


class Load:
    """The boards, from `start` until `stop`. Use it as a context."""

    def __init__(
        self,
        program: Path,
        rate_hz: float,
        before: Sequence[str] = (),
        serial_count: int = SERIAL_BOARDS,
    ) -> None:
        self._program, self._rate_hz, self._before = program, rate_hz, before
        self.late_us = (0, 0, 0)  # median, 99th percentile, maximum of the load itself
        self._process: subprocess.Popen[str] | None = None
        pairs = [os.openpty() for _ in range(serial_count)]
        self.serial_lines = [master for master, _ in pairs]
        self._slaves = [slave for _, slave in pairs]
        for slave in self._slaves:
            tty.setraw(slave)
        self.serial_paths = [os.ttyname(slave) for slave in self._slaves]
        self.bus_ports = [_free_port() for _ in range(BUSES)]

    @property
    def bus_paths(self) -> list[str]:
        """The buses as a rig's document names them."""
        return [f"udp_multicast:{GROUP}:{port}@127.0.0.1" for port in self.bus_ports]

    def start(self, seconds: float, interface: str = "127.0.0.1") -> None:
        """Let the boards send for at most so long; python-can receives only from 0.0.0.0."""
        buses = [f"{GROUP}:{port}:{NODES}:{interface}" for port in self.bus_ports]
        fds = [str(master) for master in self.serial_lines]
        self._process = subprocess.Popen(
            [
                *self._before,
                self._program,
                str(self._rate_hz),
                str(seconds),
                *fds,
                "--",
                *buses,
            ],
            pass_fds=self.serial_lines,
            stdout=subprocess.PIPE,
            text=True,
        )
        if self._process.stdout is None or self._process.stdout.readline() != "ready\n":
            raise RuntimeError("The load did not start.")

    @property
    def pid(self) -> int:
        """The process of the boards."""
        if self._process is None:
            raise RuntimeError("not started")
        return self._process.pid

    def stop(self) -> dict[str, BoardCounts]:
        """End the boards and return the counts of each, by uid."""
        if self._process is None:
            return {}
        self._process.terminate()
        output, _ = self._process.communicate(timeout=20)
        self._process = None
        rows = [line.split() for line in output.splitlines()]
        *board_rows, (_, p50, p99, maximum) = rows
        self.late_us = int(p50), int(p99), int(maximum)
        return {row[0]: BoardCounts(*(int(word) for word in row[1:])) for row in board_rows}

    def __enter__(self) -> "Load":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()
        for fd in (*self.serial_lines, *self._slaves):
            with suppress(OSError):
                os.close(fd)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
