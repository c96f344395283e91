r"""The acquisition process: it reads ports, timestamps every read call, and does nothing else.

    python -m gyrorig_daemon.links.ports.acquisition \
        '{"waits": false, "pause_ns": 2e9, "ports": [...]}'

It is a separate interpreter with few imports, because one busy thread in the same process
raises the median delay of the arrival timestamps from 35 us to 5 ms (measured on a
pseudo-terminal). Commands come in on standard input, reports go out on standard output (see
`acquisition_pipe`). A port that goes away is tried again without limit (see
`supervised_port`). When the daemon ends without closing its ports, each port is sent its
final command: it halts the pan-tilt unit, which no other process could do then. It also
halts the unit when an order arrives on a pipe of its own (see `halt_pipe`), and when the daemon
has not spoken for three seconds. Then it refuses writes to the unit until the daemon knows.
A port that sends more than its quota is not read for a while: what it sent meanwhile is
discarded and counted, and the other ports lose nothing.
"""

import contextlib
import fcntl
import gc
import json
import os
import select
import signal
import sys

from gyrorig_daemon.links.ports import acquisition_pipe
from gyrorig_daemon.links.ports.halt_pipe import ORDER, read_orders
from gyrorig_daemon.links.ports.port_kinds import READ_BYTES, Line, PortSettings
from gyrorig_daemon.links.ports.port_writes import PortWrites
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.report_queue import GATHER_NS, PIPE_BYTES, ReportQueue
from gyrorig_daemon.links.ports.serial_port import PortRefusedError
from gyrorig_daemon.links.ports.supervised_port import SupervisedPort

MAX_BUFFERED_BYTES = 32 << 20  # about ten minutes of 16 boards at 800 Hz
FINAL_WRITE_TIMEOUT_S = 0.5
# udev sets permissions shortly after it creates a node; a broken adapter may be replaced
RETRIED_REASONS = ("missing", "denied", "broken")
MAX_POLL_WAIT_S = 0.1  # longest wait; if a turn takes much longer, this process did not run
STALL_NS = 150_000_000  # far above the usual lateness of timestamps, and above the longest wait
DEAD_MAN_NS = 3_000_000_000  # longest silence of the daemon, which speaks twice per second
ORDERED = b"a halt was ordered"
SILENT = b"the daemon did not run for 3 s"
_HUNG_UP = select.EPOLLHUP | select.EPOLLERR


class Acquisition:
    """All ports of the rig, between their drivers and the pipes of the daemon."""

    def __init__(
        self,
        ports: list[SupervisedPort],
        commands_fd: int,
        reports_fd: int,
        urgent_fd: int,
        halt_fd: int | None,
        halting_orders: bytes,
    ) -> None:
        self._ports = ports
        self._by_fd: dict[int, SupervisedPort] = {}
        self._commands_fd = commands_fd
        self._halt_fd = halt_fd
        self._halting_orders = halting_orders
        self._command_buffer = bytearray()
        self._dropped_bytes: dict[int, int] = {}  # by port, not reported yet
        # readable, and read before the next transfer
        self._deferred_ports: list[SupervisedPort] = []
        self._muted_ports: list[SupervisedPort] = []
        self._lateness_ns = 0  # error bound of the timestamps of this turn
        self._last_command_ns: int | None = None  # None: the dead man's switch is not armed
        # Not `poll`, which checks every port whenever one of them has data.
        self._poll = select.epoll()
        self._poll.register(commands_fd, select.EPOLLIN)
        if halt_fd is not None:
            self._poll.register(halt_fd, select.EPOLLIN)
        self._bulk = ReportQueue(reports_fd, self._poll)
        self._urgent = ReportQueue(urgent_fd, self._poll)  # of the unit's port, and all writes
        self._writes = PortWrites(ports, self._report, self._update_poll_mask)

    def run(self) -> None:
        """Serve until the daemon closes the pipe or ends."""
        self._report(acquisition_pipe.OPENED, 0, 0, 0, b"")
        for port in self._ports:
            if port.line is not None:
                self._register_port(port, port.line)
            else:
                self._report_gone(port, port.last_refusal)
        turn_ns = raw_ns()
        while True:
            self._urgent.flush()
            if self._bulk.is_flush_due(turn_ns, bool(self._deferred_ports)):
                self._read_deferred_ports()
                self._bulk.flush()
            ready = self._poll.poll(self._timeout_s())
            before_ns, turn_ns = turn_ns, raw_ns()
            self._lateness_ns = _lateness_ns(turn_ns - before_ns)
            if self._lateness_ns and not ready:
                # SIGSTOP ends the wait without events; what arrived meanwhile is late, too.
                ready = self._poll.poll(0.0)
            if not self._handle(ready, turn_ns):
                return
            if self._writes.pending_count:
                self._writes.fail_expired()
            if self._muted_ports:
                self._unmute_ports(turn_ns)
            self._retry_closed_ports()
            self._halt_if_silent(turn_ns)

    def _handle(self, ready: list[tuple[int, int]], now_ns: int) -> bool:
        """Serve what is ready; return False when the daemon closed the pipe or ended."""
        for fd, events in ready:
            if fd in self._by_fd:
                self._serve(self._by_fd[fd], events)
            elif fd == self._bulk.fd:
                self._bulk.flush()
            elif fd == self._halt_fd:
                self._read_halt_orders()
            elif fd == self._commands_fd and not self._read_commands(now_ns):
                return False
        return True

    def _has_pending_data(self) -> bool:
        return bool(len(self._bulk) or self._deferred_ports)

    def _serve(self, port: SupervisedPort, events: int) -> None:
        if events & _HUNG_UP or (events & select.EPOLLIN and not port.is_self_timestamped):
            self._read(port, bool(events & _HUNG_UP))
        elif events & select.EPOLLIN and port not in self._deferred_ports:
            # Read it later together with what arrives until then: each frame has its own
            # timestamp, and one call reads many.
            if not self._has_pending_data():
                self._bulk.begin_batch()
            self._deferred_ports.append(port)
            self._update_poll_mask(port)
        if events & select.EPOLLOUT and port.writes:
            self._writes.resume(port)

    def _read(self, port: SupervisedPort, has_hung_up: bool) -> None:
        data = port.read(has_hung_up)
        stamp_ns = raw_ns()
        if data:
            self._report(acquisition_pipe.CHUNK, port.index, stamp_ns, self._lateness_ns, data)
            if port.exceeds_quota(len(data), stamp_ns) and port not in self._muted_ports:
                self._muted_ports.append(port)
                self._update_poll_mask(port)
        elif data is not None:
            self._drop_port(port, "it was unplugged")

    def _read_deferred_ports(self) -> None:
        ports, self._deferred_ports = self._deferred_ports, []
        for port in ports:
            self._update_poll_mask(port)
            self._read(port, False)

    def _unmute_ports(self, now_ns: int) -> None:
        """Read ports again that had exceeded their quota, from what arrives now."""
        for port in [port for port in self._muted_ports if now_ns >= port.muted_until_ns]:
            self._muted_ports.remove(port)
            discarded = port.discard()
            if discarded:
                self._report(acquisition_pipe.DROPPED, port.index, now_ns, discarded, b"")
            self._update_poll_mask(port)

    def _update_poll_mask(self, port: SupervisedPort) -> None:
        """Register for the events of the port that are of interest now."""
        if port.line is not None:
            is_left_alone = port in self._deferred_ports or port in self._muted_ports
            mask = 0 if is_left_alone else select.EPOLLIN
            self._poll.modify(port.line.fd, mask | (select.EPOLLOUT if port.writes else 0))

    def _register_port(self, port: SupervisedPort, line: Line) -> None:
        self._by_fd[line.fd] = port
        self._poll.register(line.fd, select.EPOLLIN)

    def _drop_port(self, port: SupervisedPort, reason: str, retry_now: bool = False) -> None:
        """Close a port; its pending writes fail."""
        if port in self._deferred_ports:
            self._deferred_ports.remove(port)
        if port in self._muted_ports:
            self._muted_ports.remove(port)
        if port.line is not None:
            self._poll.unregister(port.line.fd)
            del self._by_fd[port.line.fd]
            self._report_gone(port, reason)
        port.close_line(retry_now)
        self._writes.fail_all(port, b"the port was unplugged")

    def _report_gone(self, port: SupervisedPort, reason: str) -> None:
        self._report(acquisition_pipe.GONE, port.index, raw_ns(), 0, reason.encode())

    def _retry_closed_ports(self) -> None:
        if len(self._by_fd) == len(self._ports):
            return
        now_ns = raw_ns()
        for port in self._ports:
            if port.line is not None or now_ns < port.retry_ns:
                continue
            before = port.last_refusal
            try:
                port.open()
            except PortRefusedError as fault:
                if str(fault) != before:
                    self._report_gone(port, str(fault))
                continue
            if port.line is not None:
                self._report(acquisition_pipe.BACK, port.index, raw_ns(), 0, b"")
                self._register_port(port, port.line)
                if port.halt_reason:
                    # The first halt command can be lost in the adapter that was unplugged, and
                    # the halt of the daemon is refused until it knows of the first one.
                    self._writes.halt(port.halt_reason, port.is_halt_ordered)

    def _read_halt_orders(self) -> None:
        """Halt the unit if an order says so."""
        if self._halt_fd is None:
            return
        orders = read_orders(self._halt_fd)
        if orders is None:  # the daemon has ended; the pipe of commands says the same
            self._poll.unregister(self._halt_fd)
            self._halt_fd = None
        elif any(order in self._halting_orders for order in orders):
            self._writes.halt(ORDERED, True)

    def _halt_if_silent(self, now_ns: int) -> None:
        """Halt the unit if the daemon has not spoken for a while; it may be stopped, or hang."""
        if self._last_command_ns is None:
            return
        self._last_command_ns += self._lateness_ns  # this process did not run either
        # A unit that is unplugged now gets the halt when its port is open again.
        is_unplugged = any(port.is_urgent and port.line is None for port in self._ports)
        if now_ns - self._last_command_ns > DEAD_MAN_NS and not is_unplugged:
            self._last_command_ns = None  # armed again by the next command
            self._writes.halt(SILENT, False)

    def _read_commands(self, now_ns: int) -> bool:
        """Read the daemon's commands; return False when it closed the pipe or ended."""
        self._read_halt_orders()  # an order is older than the RELEASE that follows it
        data = os.read(self._commands_fd, READ_BYTES)
        if not data:
            self._send_final_commands()
            return False
        self._command_buffer += data
        while len(self._command_buffer) >= acquisition_pipe.COMMAND_HEADER.size:
            kind, index, length, deadline_ns = acquisition_pipe.COMMAND_HEADER.unpack_from(
                self._command_buffer
            )
            end = acquisition_pipe.COMMAND_HEADER.size + length
            if len(self._command_buffer) < end:
                break
            body = bytes(self._command_buffer[acquisition_pipe.COMMAND_HEADER.size : end])
            del self._command_buffer[:end]
            if self._last_command_ns is not None or kind == acquisition_pipe.PING:
                self._last_command_ns = now_ns
            if kind == acquisition_pipe.CLOSE:
                return False
            port = self._ports[index]
            if kind == acquisition_pipe.PING:
                self._report(acquisition_pipe.PONG, 0, raw_ns(), 0, b"")
            elif kind == acquisition_pipe.REOPEN:
                self._drop_port(port, "it is opened again", retry_now=True)
            elif kind == acquisition_pipe.RELEASE:
                port.halt_reason = b""
            else:
                self._writes.accept(port, body, deadline_ns)
        return True

    def _timeout_s(self) -> float:
        """Return how long to wait at most; the system rounds it up to milliseconds."""
        waiting = []
        if self._writes.pending_count:
            waiting += self._writes.deadlines_ns()
        if len(self._by_fd) < len(self._ports):
            waiting += [port.retry_ns for port in self._ports if port.line is None]
        waiting += [port.muted_until_ns for port in self._muted_ports]
        if self._deferred_ports or (len(self._bulk) and not self._bulk.is_full):
            waiting.append(self._bulk.batch_start_ns + GATHER_NS)
        if not waiting:
            return MAX_POLL_WAIT_S
        return max(0.0, min((min(waiting) - raw_ns()) * 1e-9, MAX_POLL_WAIT_S))

    def _report(self, kind: int, index: int, first_ns: int, second_ns: int, data: bytes) -> None:
        is_urgent = kind in acquisition_pipe.URGENT_KINDS or self._ports[index].is_urgent
        if is_urgent and kind != acquisition_pipe.OPENED:
            if len(self._urgent) <= MAX_BUFFERED_BYTES or kind != acquisition_pipe.CHUNK:
                self._urgent.add(kind, index, first_ns, second_ns, data)
            return
        if len(self._bulk) > MAX_BUFFERED_BYTES and kind == acquisition_pipe.CHUNK:
            self._dropped_bytes[index] = self._dropped_bytes.get(index, 0) + len(data)
            return
        # The parser of a port learns of its loss before it gets the next bytes.
        is_relaxed = len(self._bulk) < MAX_BUFFERED_BYTES // 2
        for port in list(self._dropped_bytes) if is_relaxed else [index]:
            if dropped := self._dropped_bytes.pop(port, 0):
                self._bulk.add(acquisition_pipe.DROPPED, port, raw_ns(), dropped, b"")
        if not self._has_pending_data():
            self._bulk.begin_batch()
        self._bulk.add(kind, index, first_ns, second_ns, data)

    def _send_final_commands(self) -> None:
        for port in self._ports:
            if port.line is None and port.is_urgent:  # it is being opened again
                with contextlib.suppress(PortRefusedError):
                    port.open()
            if port.line is not None:
                _write_out(port.line, port.final_command)


def _lateness_ns(turn_ns: int) -> int:
    """Return the error bound of timestamps after a turn of this length."""
    return turn_ns if turn_ns > STALL_NS else 0


def _write_out(line: Line, data: bytes) -> None:
    """Write what the port takes within half a second."""
    poll = select.poll()
    poll.register(line.fd, select.POLLOUT)
    end_ns = raw_ns() + int(FINAL_WRITE_TIMEOUT_S * 1e9)
    while data and raw_ns() < end_ns:
        poll.poll(50)
        try:
            data = data[line.write(data) :]
        except BlockingIOError:
            continue
        except OSError:
            return


def _open_all(ports: list[SupervisedPort], wait_for_ports: bool, reports_fd: int) -> bool:
    """Open all ports; report and return False if one fails that must not be retried."""
    for port in ports:
        try:
            port.open()
        except PortRefusedError as fault:
            if wait_for_ports and fault.reason in RETRIED_REASONS:
                continue
            # This process ends now, but a unit that an earlier program left turning must stop.
            for opened in ports:
                if opened.line is not None:
                    _write_out(opened.line, opened.final_command)
            text = f"{fault.reason}\n{fault}".encode()
            os.write(
                reports_fd,
                acquisition_pipe.REPORT_HEADER.pack(
                    acquisition_pipe.REFUSED, port.index, len(text), 0, 0
                )
                + text,
            )
            return False
    return True


def main() -> int:
    """Run with the settings of the only argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the daemon decides when to end
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    commands_fd, reports_fd = 0, 1
    with contextlib.suppress(OSError):
        fcntl.fcntl(reports_fd, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    arguments = json.loads(sys.argv[1])
    urgent_fd, halt_fd = arguments["urgent_fd"], arguments["halt_fd"]
    halting_orders = ORDER + bytes(arguments["halting_signals"])
    ports = [
        SupervisedPort(index, PortSettings(**settings), arguments["pause_ns"])
        for index, settings in enumerate(arguments["ports"])
    ]
    if not _open_all(ports, arguments["waits"], reports_fd):
        return 1
    for descriptor in (reports_fd, urgent_fd):
        os.set_blocking(descriptor, False)
    gc.freeze()
    gc.disable()  # this process creates no reference cycles
    Acquisition(ports, commands_fd, reports_fd, urgent_fd, halt_fd, halting_orders).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
