"""The acquisition process: reads ports, stamps every read call, and does nothing else.

    python -m gyrorig_daemon.links.acquire '{"waits": false, "pause_ns": 2e9, "ports": [...]}'

Its own interpreter with few imports, because one busy thread in the same process moves
the median arrival stamp from 35 us to 5 ms (reference: timesync.md section 8). Orders
come in on standard input, reports go out on standard output (see `wire`). A port that
goes away is tried again for ever (see `supervised_port`). When the daemon goes away
without saying so, each port is sent its farewell: the pan-tilt unit's is the order to
halt, which nobody else could send then.
"""

import contextlib
import fcntl
import gc
import json
import os
import select
import signal
import sys

from gyrorig_daemon.links import wire
from gyrorig_daemon.links.port_kinds import READ_BYTES, Line, PortSettings
from gyrorig_daemon.links.raw_clock import raw_ns
from gyrorig_daemon.links.serial_port import RefusedError
from gyrorig_daemon.links.supervised_port import SupervisedPort, Write

PIPE_BYTES = 1 << 20
MAX_HELD_BYTES = 32 << 20  # about ten minutes of 16 boards at 800 Hz
FAREWELL_S = 0.5
# udev gives a node its rights a moment after the node; a broken adapter may be exchanged
WAITED_FOR = ("missing", "denied", "broken")
HEARTBEAT_S = 0.1  # the longest wait: what takes much longer is this process standing still
STALL_NS = 150_000_000  # beyond the stamps' usual lateness by far, and above the heartbeat
# Chunks wait so long for others before they are handed over: they are stamped already, and
# each handing over costs the daemon a wake-up. What somebody waits for goes at once.
GATHER_NS = 4_000_000
GATHER_BYTES = 1 << 16
_HUNG_UP = select.EPOLLHUP | select.EPOLLERR


class Acquisition:
    """All ports of the rig, between their drivers and two pipes."""

    def __init__(self, ports: list[SupervisedPort], orders_fd: int, reports_fd: int) -> None:
        self._ports = ports
        self._by_fd: dict[int, SupervisedPort] = {}
        self._orders_fd = orders_fd
        self._reports_fd = reports_fd
        self._orders = bytearray()
        self._reports = bytearray()
        self._dropped_bytes = 0
        self._is_urgent = False
        self._is_full = False  # the pipe
        self._gathered_ns = 0  # since when reports wait, or frames to be read
        self._put_off: list[SupervisedPort] = []  # readable, and read with the next handing over
        self._unwritten = 0  # writes under way, of all ports
        self._late_ns = 0  # by which the stamps of this turn may be late
        # Not `poll`: that asks every port whenever one of them has something.
        self._poll = select.epoll()
        self._poll.register(orders_fd, select.EPOLLIN)

    def run(self) -> None:
        """Serve until the daemon says so, or is gone."""
        self._report(wire.OPENED, 0, 0, 0, b"")
        for port in self._ports:
            if port.line is not None:
                self._watch(port, port.line)
            else:
                self._say_gone(port, port.refusal)
        turn_ns = raw_ns()
        while True:
            if self._is_due(turn_ns):
                self._read_put_off()
                self._flush()
            ready = self._poll.poll(self._timeout_s())
            before_ns, turn_ns = turn_ns, raw_ns()
            self._late_ns = _lateness_ns(turn_ns - before_ns)
            if self._late_ns and not ready:
                # A stop ends the waiting with nothing: what has come meanwhile is late, too.
                ready = self._poll.poll(0.0)
            for fd, events in ready:
                if fd in self._by_fd:
                    self._serve(self._by_fd[fd], events)
                elif fd == self._reports_fd:
                    self._flush()
                elif fd == self._orders_fd and not self._take_orders():
                    return
            if self._unwritten:
                self._expire_writes()
            if len(self._by_fd) < len(self._ports):
                self._try_again()

    def _is_due(self, now_ns: int) -> bool:
        """Return whether something waits that has waited enough."""
        if self._is_urgent or len(self._reports) >= GATHER_BYTES:
            return bool(self._reports)
        return now_ns - self._gathered_ns >= GATHER_NS and self._waits()

    def _waits(self) -> bool:
        return bool(self._reports or self._put_off)

    def _serve(self, port: SupervisedPort, events: int) -> None:
        if events & _HUNG_UP or (events & select.EPOLLIN and not port.stamps_itself):
            self._read(port, bool(events & _HUNG_UP))
        elif events & select.EPOLLIN and port not in self._put_off:
            # What comes meanwhile is read with it, and each frame has its own stamp: one
            # call for many instead of a wake-up for each.
            if not self._waits():
                self._gathered_ns = raw_ns()
            self._put_off.append(port)
            self._look_out(port)
        if events & select.EPOLLOUT and port.writes:
            self._write(port)

    def _read(self, port: SupervisedPort, has_hung_up: bool) -> None:
        data = port.read(has_hung_up)
        stamp_ns = raw_ns()
        if data:
            self._report(wire.CHUNK, port.index, stamp_ns, self._late_ns, data)
        elif data is not None:
            self._lose(port, "it hung up")

    def _read_put_off(self) -> None:
        ports, self._put_off = self._put_off, []
        for port in ports:
            self._look_out(port)
            self._read(port, False)

    def _look_out(self, port: SupervisedPort) -> None:
        """Have the port's events told that are of interest now."""
        if port.line is not None:
            mask = 0 if port in self._put_off else select.EPOLLIN
            self._poll.modify(port.line.fd, mask | (select.EPOLLOUT if port.writes else 0))

    def _watch(self, port: SupervisedPort, line: Line) -> None:
        self._by_fd[line.fd] = port
        self._poll.register(line.fd, select.EPOLLIN)

    def _lose(self, port: SupervisedPort, why: str, now: bool = False) -> None:
        """Let go of a port; what was to be written to it fails."""
        if port in self._put_off:
            self._put_off.remove(port)
        if port.line is not None:
            self._poll.unregister(port.line.fd)
            del self._by_fd[port.line.fd]
            self._say_gone(port, why)
        port.shut(now)
        while port.writes:
            self._end_write(port, b"the port hung up")

    def _say_gone(self, port: SupervisedPort, why: str) -> None:
        self._report(wire.GONE, port.index, raw_ns(), 0, why.encode())

    def _try_again(self) -> None:
        if len(self._by_fd) == len(self._ports):
            return
        now_ns = raw_ns()
        for port in self._ports:
            if port.line is not None or now_ns < port.retry_ns:
                continue
            before = port.refusal
            try:
                port.open()
            except RefusedError as fault:
                if str(fault) != before:
                    self._say_gone(port, str(fault))
                continue
            if port.line is not None:
                self._report(wire.BACK, port.index, raw_ns(), 0, b"")
                self._watch(port, port.line)

    def _take_orders(self) -> bool:
        """Read the daemon's orders; return False when it closed or is gone."""
        data = os.read(self._orders_fd, READ_BYTES)
        if not data:
            self._say_farewell()
            return False
        self._orders += data
        while len(self._orders) >= wire.ORDER.size:
            kind, index, length, deadline_ns = wire.ORDER.unpack_from(self._orders)
            end = wire.ORDER.size + length
            if len(self._orders) < end:
                break
            body = bytes(self._orders[wire.ORDER.size : end])
            del self._orders[:end]
            if kind == wire.CLOSE:
                return False
            port = self._ports[index]
            if kind == wire.PING:
                self._report(wire.PONG, 0, raw_ns(), 0, b"")
            elif kind == wire.REOPEN:
                self._lose(port, "it is opened anew", now=True)
            else:
                port.writes.append(Write(body, deadline_ns))
                self._unwritten += 1
                self._write(port)
        return True

    def _write(self, port: SupervisedPort) -> None:
        write = port.writes[0]
        if port.line is None:
            self._end_write(port, b"the port hung up")
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
            self._look_out(port)
            return
        self._report(wire.WRITTEN, port.index, write.before_ns, after_ns, b"")
        self._next_write(port)

    def _end_write(self, port: SupervisedPort, reason: bytes) -> None:
        self._report(wire.FAULT, port.index, raw_ns(), 0, reason)
        self._next_write(port)

    def _next_write(self, port: SupervisedPort) -> None:
        port.writes.pop(0)
        self._unwritten -= 1
        self._look_out(port)

    def _expire_writes(self) -> None:
        for port in self._ports:
            while port.writes and raw_ns() > port.writes[0].deadline_ns:
                self._end_write(port, b"it does not take bytes")

    def _timeout_s(self) -> float:
        """Return how long to wait at most; the system rounds it up to milliseconds."""
        waiting = []
        if self._unwritten:
            waiting += [port.writes[0].deadline_ns for port in self._ports if port.writes]
        if len(self._by_fd) < len(self._ports):
            waiting += [port.retry_ns for port in self._ports if port.line is None]
        if self._put_off or (self._reports and not self._is_full):
            waiting.append(self._gathered_ns + GATHER_NS)
        if not waiting:
            return HEARTBEAT_S
        return max(0.0, min((min(waiting) - raw_ns()) * 1e-9, HEARTBEAT_S))

    def _report(self, kind: int, index: int, first_ns: int, second_ns: int, data: bytes) -> None:
        if len(self._reports) > MAX_HELD_BYTES and kind == wire.CHUNK:
            self._dropped_bytes += len(data)
            return
        if self._dropped_bytes and len(self._reports) < MAX_HELD_BYTES // 2:
            lost = wire.REPORT.pack(wire.LOST, index, 0, raw_ns(), self._dropped_bytes)
            self._reports += lost
            self._dropped_bytes = 0
        if not self._waits():
            self._gathered_ns = raw_ns()
        self._is_urgent = self._is_urgent or kind != wire.CHUNK or self._ports[index].is_awaited
        self._reports += wire.REPORT.pack(kind, index, len(data), first_ns, second_ns) + data

    def _flush(self) -> None:
        """Hand over as much as the pipe takes, and wait for room only if some is left."""
        try:
            while self._reports:
                sent = os.write(self._reports_fd, self._reports[:PIPE_BYTES])
                del self._reports[:sent]
        except BlockingIOError:
            if not self._is_full:
                self._poll.register(self._reports_fd, select.EPOLLOUT)
            self._is_full = True
            return
        except OSError:
            self._reports.clear()  # nobody reads; the orders' pipe will tell the same
        if self._is_full:
            self._poll.unregister(self._reports_fd)
        self._is_urgent = self._is_full = False

    def _say_farewell(self) -> None:
        for port in self._ports:
            if port.line is not None:
                _write_out(port.line, port.farewell)


def _lateness_ns(turn_ns: int) -> int:
    """Return by how much stamps may be late after a turn that took so long."""
    return turn_ns if turn_ns > STALL_NS else 0


def _write_out(line: Line, data: bytes) -> None:
    """Write what a stuck port takes within half a second."""
    poll = select.poll()
    poll.register(line.fd, select.POLLOUT)
    end_ns = raw_ns() + int(FAREWELL_S * 1e9)
    while data and raw_ns() < end_ns:
        poll.poll(50)
        try:
            data = data[line.write(data) :]
        except BlockingIOError:
            continue
        except OSError:
            return


def _open_all(ports: list[SupervisedPort], waits: bool, reports_fd: int) -> bool:
    """Open what can be opened; return False, and say why, where a port must not be waited for."""
    for port in ports:
        try:
            port.open()
        except RefusedError as fault:
            if waits and fault.reason in WAITED_FOR:
                continue
            # Nothing will be done here then, but what an earlier program left turning ends.
            for opened in ports:
                if opened.line is not None:
                    _write_out(opened.line, opened.farewell)
            text = f"{fault.reason}\n{fault}".encode()
            os.write(reports_fd, wire.REPORT.pack(wire.REFUSED, port.index, len(text), 0, 0) + text)
            return False
    return True


def main() -> int:
    """Run on the ports named in the only argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the daemon decides when it is over
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    orders_fd, reports_fd = 0, 1
    with contextlib.suppress(OSError):
        fcntl.fcntl(reports_fd, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    wanted = json.loads(sys.argv[1])
    ports = [
        SupervisedPort(index, PortSettings(**settings), wanted["pause_ns"])
        for index, settings in enumerate(wanted["ports"])
    ]
    if not _open_all(ports, wanted["waits"], reports_fd):
        return 1
    os.set_blocking(reports_fd, False)
    gc.freeze()
    gc.disable()  # nothing here makes cycles
    Acquisition(ports, orders_fd, reports_fd).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
