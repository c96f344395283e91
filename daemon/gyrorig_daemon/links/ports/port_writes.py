"""Writes of the acquisition process: those of the daemon, and the halts of this process.

Theory of operation. Each port has a row of writes; the first one is under way. A halt fails the
row of the unit's port, sends the final command, and refuses every later write until `release`:
an order that the daemon had sent before it knew of the halt must not move the unit again.
"""

import os
from collections.abc import Callable

from gyrorig_daemon.links.ports import acquisition_pipe
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.supervised_port import PendingWrite, SupervisedPort

HALT_WRITE_NS = 500_000_000

Report = Callable[[int, int, int, int, bytes], None]


class PortWrites:
    """The writes of all ports."""

    def __init__(
        self,
        ports: list[SupervisedPort],
        report: Report,
        update_poll_mask: Callable[[SupervisedPort], None],
    ) -> None:
        """Start without writes.

        Args:
            ports: all ports of the rig.
            report: sends a report to the daemon.
            update_poll_mask: called when a port begins or ceases to wait for room.
        """
        self._ports = ports
        self._report = report
        self._update_poll_mask = update_poll_mask
        self.pending_count = 0  # of all ports

    def accept(self, port: SupervisedPort, data: bytes, deadline_ns: int) -> None:
        """Begin a write of the daemon, or refuse it because the unit was halted."""
        if port.halt_reason:
            self._report_refusal(port)
        else:
            self._begin(port, PendingWrite(data, deadline_ns))

    def halt(self, reason: bytes, is_ordered: bool) -> None:
        """Send the final commands now, and refuse writes until the daemon knows of it."""
        for port in self._ports:
            if not port.is_urgent or port.line is None:
                continue
            port.halt_reason, port.is_halt_ordered = reason, is_ordered
            while port.writes:
                if not port.writes[0].is_own:
                    self._report_refusal(port)
                self._end(port)
            deadline_ns = raw_ns() + HALT_WRITE_NS
            self._begin(port, PendingWrite(port.final_command, deadline_ns, is_own=True))

    def resume(self, port: SupervisedPort) -> None:
        """Write what the port takes now of its first write."""
        write = port.writes[0]
        if port.line is None:
            self._fail(port, b"the port was unplugged")
            return
        if not write.before_ns:
            write.before_ns = raw_ns()
        try:
            sent = port.line.write(write.data)
        except BlockingIOError:
            sent = 0
        except OSError as fault:
            self._fail(port, os.strerror(fault.errno or 0).encode())
            return
        after_ns = raw_ns()
        write.data = write.data[sent:]
        if write.data:
            self._update_poll_mask(port)
            return
        if not write.is_own:
            self._report(acquisition_pipe.WRITTEN, port.index, write.before_ns, after_ns, b"")
        self._end(port)

    def fail_all(self, port: SupervisedPort, reason: bytes) -> None:
        """Fail the writes of a port that is gone."""
        while port.writes:
            self._fail(port, reason)

    def fail_expired(self) -> None:
        """Fail the writes whose port took no bytes in time."""
        for port in self._ports:
            while port.writes and raw_ns() > port.writes[0].deadline_ns:
                self._fail(port, b"the port takes no bytes")

    def deadlines_ns(self) -> list[int]:
        """Return when the first write of each port expires."""
        return [port.writes[0].deadline_ns for port in self._ports if port.writes]

    def _begin(self, port: SupervisedPort, write: PendingWrite) -> None:
        port.writes.append(write)
        self.pending_count += 1
        self.resume(port)

    def _fail(self, port: SupervisedPort, reason: bytes) -> None:
        if not port.writes[0].is_own:
            self._report(acquisition_pipe.FAULT, port.index, raw_ns(), 0, reason)
        self._end(port)

    def _end(self, port: SupervisedPort) -> None:
        port.writes.pop(0)
        self.pending_count -= 1
        self._update_poll_mask(port)

    def _report_refusal(self, port: SupervisedPort) -> None:
        is_ordered = int(port.is_halt_ordered)
        self._report(acquisition_pipe.HALTED, port.index, raw_ns(), is_ordered, port.halt_reason)
