r"""The acquisition process: it reads ports, timestamps every read call, and does nothing else.

    python -m gyrorig_daemon.links.ports.acquisition \
        '{"waits": false, "pause_ns": 2e9, "ports": [...]}'

It is a separate interpreter with few imports, because one busy thread in the same process
raises the median delay of the arrival timestamps from 35 us to 5 ms (measured on a
pseudo-terminal). Commands come in on standard input, reports go out on standard output (see
`acquisition_pipe`). A port that goes away is tried again without limit (see
`supervised_port`). When the daemon ends without closing its ports, each port is sent its
final command: it halts the pan-tilt unit, which no other process could do then.
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
from gyrorig_daemon.links.ports.port_kinds import READ_BYTES, Line, PortSettings
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.serial_port import PortRefusedError
from gyrorig_daemon.links.ports.supervised_port import PendingWrite, SupervisedPort

PIPE_BYTES = 1 << 20
MAX_BUFFERED_BYTES = 32 << 20  # about ten minutes of 16 boards at 800 Hz
FINAL_WRITE_TIMEOUT_S = 0.5
# udev sets permissions shortly after it creates a node; a broken adapter may be replaced
RETRIED_REASONS = ("missing", "denied", "broken")
MAX_POLL_WAIT_S = 0.1  # longest wait; if a turn takes much longer, this process did not run
STALL_NS = 150_000_000  # far above the usual lateness of timestamps, and above the longest wait
# Chunks are collected for this time before they are sent. They have their timestamps already,
# and each transfer wakes the daemon up. Urgent reports are sent at once.
GATHER_NS = 4_000_000
GATHER_BYTES = 1 << 16
_HUNG_UP = select.EPOLLHUP | select.EPOLLERR


class Acquisition:
    """All ports of the rig, between their drivers and two pipes."""

    def __init__(self, ports: list[SupervisedPort], commands_fd: int, reports_fd: int) -> None:
        self._ports = ports
        self._by_fd: dict[int, SupervisedPort] = {}
        self._commands_fd = commands_fd
        self._reports_fd = reports_fd
        self._command_buffer = bytearray()
        self._report_buffer = bytearray()
        self._dropped_bytes = 0
        self._is_urgent = False
        self._is_pipe_full = False  # the pipe of reports
        self._batch_start_ns = 0  # since when reports or readable frames wait
        self._deferred_ports: list[
            SupervisedPort
        ] = []  # readable, and read before the next transfer
        self._pending_write_count = 0  # of all ports
        self._lateness_ns = 0  # error bound of the timestamps of this turn
        # Not `poll`, which checks every port whenever one of them has data.
        self._poll = select.epoll()
        self._poll.register(commands_fd, select.EPOLLIN)

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
            if self._is_flush_due(turn_ns):
                self._read_deferred_ports()
                self._flush()
            ready = self._poll.poll(self._timeout_s())
            before_ns, turn_ns = turn_ns, raw_ns()
            self._lateness_ns = _lateness_ns(turn_ns - before_ns)
            if self._lateness_ns and not ready:
                # SIGSTOP ends the wait without events; what arrived meanwhile is late, too.
                ready = self._poll.poll(0.0)
            for fd, events in ready:
                if fd in self._by_fd:
                    self._serve(self._by_fd[fd], events)
                elif fd == self._reports_fd:
                    self._flush()
                elif fd == self._commands_fd and not self._read_commands():
                    return
            if self._pending_write_count:
                self._fail_expired_writes()
            if len(self._by_fd) < len(self._ports):
                self._retry_closed_ports()

    def _is_flush_due(self, now_ns: int) -> bool:
        """Return whether something has waited long enough."""
        if self._is_urgent or len(self._report_buffer) >= GATHER_BYTES:
            return bool(self._report_buffer)
        return now_ns - self._batch_start_ns >= GATHER_NS and self._has_pending_data()

    def _has_pending_data(self) -> bool:
        return bool(self._report_buffer or self._deferred_ports)

    def _serve(self, port: SupervisedPort, events: int) -> None:
        if events & _HUNG_UP or (events & select.EPOLLIN and not port.is_self_timestamped):
            self._read(port, bool(events & _HUNG_UP))
        elif events & select.EPOLLIN and port not in self._deferred_ports:
            # Read it later together with what arrives until then: each frame has its own
            # timestamp, and one call reads many.
            if not self._has_pending_data():
                self._batch_start_ns = raw_ns()
            self._deferred_ports.append(port)
            self._update_poll_mask(port)
        if events & select.EPOLLOUT and port.writes:
            self._write(port)

    def _read(self, port: SupervisedPort, has_hung_up: bool) -> None:
        data = port.read(has_hung_up)
        stamp_ns = raw_ns()
        if data:
            self._report(acquisition_pipe.CHUNK, port.index, stamp_ns, self._lateness_ns, data)
        elif data is not None:
            self._drop_port(port, "it was unplugged")

    def _read_deferred_ports(self) -> None:
        ports, self._deferred_ports = self._deferred_ports, []
        for port in ports:
            self._update_poll_mask(port)
            self._read(port, False)

    def _update_poll_mask(self, port: SupervisedPort) -> None:
        """Register for the events of the port that are of interest now."""
        if port.line is not None:
            mask = 0 if port in self._deferred_ports else select.EPOLLIN
            self._poll.modify(port.line.fd, mask | (select.EPOLLOUT if port.writes else 0))

    def _register_port(self, port: SupervisedPort, line: Line) -> None:
        self._by_fd[line.fd] = port
        self._poll.register(line.fd, select.EPOLLIN)

    def _drop_port(self, port: SupervisedPort, reason: str, retry_now: bool = False) -> None:
        """Close a port; its pending writes fail."""
        if port in self._deferred_ports:
            self._deferred_ports.remove(port)
        if port.line is not None:
            self._poll.unregister(port.line.fd)
            del self._by_fd[port.line.fd]
            self._report_gone(port, reason)
        port.close_line(retry_now)
        while port.writes:
            self._end_write(port, b"the port was unplugged")

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

    def _read_commands(self) -> bool:
        """Read the daemon's commands; return False when it closed the pipe or ended."""
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
            if kind == acquisition_pipe.CLOSE:
                return False
            port = self._ports[index]
            if kind == acquisition_pipe.PING:
                self._report(acquisition_pipe.PONG, 0, raw_ns(), 0, b"")
            elif kind == acquisition_pipe.REOPEN:
                self._drop_port(port, "it is opened again", retry_now=True)
            else:
                port.writes.append(PendingWrite(body, deadline_ns))
                self._pending_write_count += 1
                self._write(port)
        return True

    def _write(self, port: SupervisedPort) -> None:
        write = port.writes[0]
        if port.line is None:
            self._end_write(port, b"the port was unplugged")
            return
        if not write.before_ns:
            write.before_ns = raw_ns()
        try:
            sent = port.line.write(write.data)
        except BlockingIOError:
            sent = 0
        except OSError as fault:
            self._end_write(port, os.strerror(fault.errno or 0).encode())
            return
        after_ns = raw_ns()
        write.data = write.data[sent:]
        if write.data:
            self._update_poll_mask(port)
            return
        self._report(acquisition_pipe.WRITTEN, port.index, write.before_ns, after_ns, b"")
        self._next_write(port)

    def _end_write(self, port: SupervisedPort, reason: bytes) -> None:
        self._report(acquisition_pipe.FAULT, port.index, raw_ns(), 0, reason)
        self._next_write(port)

    def _next_write(self, port: SupervisedPort) -> None:
        port.writes.pop(0)
        self._pending_write_count -= 1
        self._update_poll_mask(port)

    def _fail_expired_writes(self) -> None:
        for port in self._ports:
            while port.writes and raw_ns() > port.writes[0].deadline_ns:
                self._end_write(port, b"the port takes no bytes")

    def _timeout_s(self) -> float:
        """Return how long to wait at most; the system rounds it up to milliseconds."""
        waiting = []
        if self._pending_write_count:
            waiting += [port.writes[0].deadline_ns for port in self._ports if port.writes]
        if len(self._by_fd) < len(self._ports):
            waiting += [port.retry_ns for port in self._ports if port.line is None]
        if self._deferred_ports or (self._report_buffer and not self._is_pipe_full):
            waiting.append(self._batch_start_ns + GATHER_NS)
        if not waiting:
            return MAX_POLL_WAIT_S
        return max(0.0, min((min(waiting) - raw_ns()) * 1e-9, MAX_POLL_WAIT_S))

    def _report(self, kind: int, index: int, first_ns: int, second_ns: int, data: bytes) -> None:
        if len(self._report_buffer) > MAX_BUFFERED_BYTES and kind == acquisition_pipe.CHUNK:
            self._dropped_bytes += len(data)
            return
        if self._dropped_bytes and len(self._report_buffer) < MAX_BUFFERED_BYTES // 2:
            lost = acquisition_pipe.REPORT_HEADER.pack(
                acquisition_pipe.DROPPED, index, 0, raw_ns(), self._dropped_bytes
            )
            self._report_buffer += lost
            self._dropped_bytes = 0
        if not self._has_pending_data():
            self._batch_start_ns = raw_ns()
        self._is_urgent = (
            self._is_urgent or kind != acquisition_pipe.CHUNK or self._ports[index].is_urgent
        )
        self._report_buffer += (
            acquisition_pipe.REPORT_HEADER.pack(kind, index, len(data), first_ns, second_ns) + data
        )

    def _flush(self) -> None:
        """Send as much as the pipe takes, and wait for room only if something is left."""
        try:
            while self._report_buffer:
                sent = os.write(self._reports_fd, self._report_buffer[:PIPE_BYTES])
                del self._report_buffer[:sent]
        except BlockingIOError:
            if not self._is_pipe_full:
                self._poll.register(self._reports_fd, select.EPOLLOUT)
            self._is_pipe_full = True
            return
        except OSError:
            self._report_buffer.clear()  # nobody reads; the pipe of commands will report the same
        if self._is_pipe_full:
            self._poll.unregister(self._reports_fd)
        self._is_urgent = self._is_pipe_full = False

    def _send_final_commands(self) -> None:
        for port in self._ports:
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
    ports = [
        SupervisedPort(index, PortSettings(**settings), arguments["pause_ns"])
        for index, settings in enumerate(arguments["ports"])
    ]
    if not _open_all(ports, arguments["waits"], reports_fd):
        return 1
    os.set_blocking(reports_fd, False)
    gc.freeze()
    gc.disable()  # this process creates no reference cycles
    Acquisition(ports, commands_fd, reports_fd).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
