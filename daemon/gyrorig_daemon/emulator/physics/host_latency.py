"""Latency model of the host: floor, jitter and stalls between a device and the program.

Arrival = line time + floor + exponential jitter. Sometimes the host stalls, all bytes wait and then
arrive together. The order is kept on each port. Stalls are a Poisson process, one in 20 s, uniform
from 5 to 200 ms.

A frame of a bus that is ready while the one before it still waits arrives together with it: one
interrupt or one USB transfer delivers both. An exponential has no memory, so the latency of each
frame is the same exponential, however many frames precede it. On a serial line, few frames are so
close, and each one draws its own jitter.
"""

from dataclasses import dataclass

import numpy as np

_DRAW_BATCH = 4096


@dataclass(frozen=True, slots=True)
class LatencyTruth:
    """True latencies of the host."""

    floor_s: float = 60e-6
    jitter_s: float = 0.3e-3  # mean of the exponential
    stall_interval_s: float = 20.0  # mean; 0 = no stalls
    stall_shortest_s: float = 5e-3
    stall_longest_s: float = 200e-3
    write_floor_s: float = 50e-6  # from the write call to the first bit on the line
    write_jitter_s: float = 0.1e-3


class HostLatency:
    """Arrival times of the ports of a host; stalls are common to all ports."""

    def __init__(
        self,
        truth: LatencyTruth,
        origin_ns: int,
        rng: np.random.Generator,
        prompt_ports: tuple[str, ...] = (),
        bus_ports: tuple[str, ...] = (),
    ) -> None:
        """Draw from `rng`.

        Args:
            truth: the latencies.
            origin_ns: there is no stall before.
            rng: source of the random numbers.
            prompt_ports: ports whose bytes no stall delays.
            bus_ports: ports whose frames arrive together if one waits for the host.
        """
        self._truth = truth
        self._prompt_ports, self._bus_ports = prompt_ports, bus_ports
        self._jitter_rng, self._stall_rng, self._write_rng = rng.spawn(3)
        self._jitter: list[float] = []
        self._write_jitter: list[float] = []
        self._stall_ns = (origin_ns, origin_ns)
        self._last_ns: dict[str, int] = {}

    def arrival_ns(self, port: str, line_ns: int) -> int:
        """Return when the host receives bytes that left the line at `line_ns`.

        Calls must be nearly in order of time, over all ports together.
        """
        last_ns = self._last_ns.get(port, 0)
        if port in self._bus_ports and line_ns + int(self._truth.floor_s * 1e9) <= last_ns:
            return last_ns
        if not self._jitter:
            self._jitter = self._jitter_rng.exponential(self._truth.jitter_s, _DRAW_BATCH).tolist()
        due = line_ns + int((self._truth.floor_s + self._jitter.pop()) * 1e9)
        if port not in self._prompt_ports:
            due = self._after_stall(due)
        due = max(due, last_ns)
        self._last_ns[port] = due
        return due

    def line_ns(self, write_ns: int) -> int:
        """Return when the first bit of a write at `write_ns` starts on the line."""
        if not self._write_jitter:
            jitter_s = self._write_rng.exponential(self._truth.write_jitter_s, _DRAW_BATCH)
            self._write_jitter = jitter_s[::-1].tolist()  # the last one is taken first
        return write_ns + int((self._truth.write_floor_s + self._write_jitter.pop()) * 1e9)

    def _after_stall(self, due_ns: int) -> int:
        if self._truth.stall_interval_s <= 0.0:
            return due_ns
        while due_ns >= self._stall_ns[1]:
            wait = self._stall_rng.exponential(self._truth.stall_interval_s)
            length = self._stall_rng.uniform(
                self._truth.stall_shortest_s, self._truth.stall_longest_s
            )
            begin = self._stall_ns[1] + int(wait * 1e9)
            self._stall_ns = (begin, begin + int(length * 1e9))
        return self._stall_ns[1] if self._stall_ns[0] <= due_ns else due_ns
