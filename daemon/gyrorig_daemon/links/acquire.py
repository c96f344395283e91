"""The acquisition process: reads ports, stamps every read call, and does nothing else.

    python -m gyrorig_daemon.links.acquire '[["/dev/ttyUSB0", 115200, " H "], ...]'

Its own interpreter with few imports, because one busy thread in the same process moves
the median arrival stamp from 35 us to 5 ms (reference: timesync.md section 8). Orders
come in on standard input, reports go out on standard output (see `wire`). When the
daemon goes away without saying so, each port is sent its farewell: the pan-tilt unit's
is the order to halt, which nobody else could send then.
"""

import contextlib
import fcntl
import gc
import json
import os
import select
import signal
import sys
import time
from dataclasses import dataclass, field

from gyrorig_daemon.links import wire
from gyrorig_daemon.links.serial_port import RefusedError, open_port

READ_BYTES = 65_536
PIPE_BYTES = 1 << 20
MAX_HELD_BYTES = 32 << 20  # about ten minutes of 16 boards at 800 Hz
FAREWELL_S = 0.5
_GONE = select.POLLHUP | select.POLLERR | select.POLLNVAL


def raw_ns() -> int:
    """Return CLOCK_MONOTONIC_RAW in ns: no NTP slew enters it."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


@dataclass(slots=True)
class _Write:
    """A write under way."""

    data: bytes
    deadline_ns: int
    before_ns: int = 0


@dataclass(slots=True)
class _Port:
    """One open port."""

    index: int
    fd: int
    farewell: bytes
    writes: list[_Write] = field(default_factory=list)
    gone: bool = False


class Acquisition:
    """All ports of the rig, between the serial drivers and two pipes."""

    def __init__(self, ports: list[_Port], orders_fd: int, reports_fd: int) -> None:
        self._ports = {port.fd: port for port in ports}
        self._by_index = {port.index: port for port in ports}
        self._orders_fd = orders_fd
        self._reports_fd = reports_fd
        self._orders = bytearray()
        self._reports = bytearray()
        self._dropped_bytes = 0
        self._poll = select.poll()
        self._poll.register(orders_fd, select.POLLIN)
        for port in ports:
            self._poll.register(port.fd, select.POLLIN)

    def run(self) -> None:
        """Serve until the daemon says so, or is gone."""
        self._report(wire.OPENED, 0, 0, 0, b"")
        while True:
            self._flush()
            for fd, events in self._poll.poll(self._timeout_ms()):
                if fd in self._ports:
                    port = self._ports[fd]
                    if events & (select.POLLIN | _GONE):
                        self._read(port)
                    if events & select.POLLOUT and port.writes:
                        self._write(port)
                elif fd == self._reports_fd:
                    self._flush()
                elif not self._take_orders():
                    return
            self._expire_writes()

    def _read(self, port: _Port) -> None:
        if port.gone:
            return
        try:
            data = os.read(port.fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        stamp_ns = raw_ns()
        if not data:
            port.gone = True
            self._poll.unregister(port.fd)
        self._report(wire.CHUNK, port.index, stamp_ns, 0, data)

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
            port = self._by_index[index]
            port.writes.append(_Write(body, deadline_ns))
            self._write(port)
        return True

    def _write(self, port: _Port) -> None:
        write = port.writes[0]
        if port.gone:
            self._end_write(port, b"the port hung up")
            return
        if not write.before_ns:
            write.before_ns = raw_ns()
        try:
            sent = os.write(port.fd, write.data)
        except BlockingIOError:
            sent = 0
        except OSError as fault:
            self._end_write(port, os.strerror(fault.errno or 0).encode())
            return
        after_ns = raw_ns()
        write.data = write.data[sent:]
        if write.data:
            self._poll.modify(port.fd, select.POLLIN | select.POLLOUT)
            return
        self._report(wire.WRITTEN, port.index, write.before_ns, after_ns, b"")
        self._next_write(port)

    def _end_write(self, port: _Port, reason: bytes) -> None:
        self._report(wire.FAULT, port.index, raw_ns(), 0, reason)
        self._next_write(port)

    def _next_write(self, port: _Port) -> None:
        port.writes.pop(0)
        if not port.gone:
            mask = select.POLLIN | (select.POLLOUT if port.writes else 0)
            self._poll.modify(port.fd, mask)

    def _expire_writes(self) -> None:
        for port in self._ports.values():
            while port.writes and raw_ns() > port.writes[0].deadline_ns:
                self._end_write(port, b"it does not take bytes")

    def _timeout_ms(self) -> int | None:
        waiting = [port.writes[0].deadline_ns for port in self._ports.values() if port.writes]
        if not waiting:
            return None
        return max(0, (min(waiting) - raw_ns()) // 1_000_000 + 1)

    def _report(self, kind: int, index: int, first_ns: int, second_ns: int, data: bytes) -> None:
        if len(self._reports) > MAX_HELD_BYTES and kind == wire.CHUNK and data:
            self._dropped_bytes += len(data)
            return
        if self._dropped_bytes and len(self._reports) < MAX_HELD_BYTES // 2:
            lost = wire.REPORT.pack(wire.LOST, index, 0, raw_ns(), self._dropped_bytes)
            self._reports += lost
            self._dropped_bytes = 0
        self._reports += wire.REPORT.pack(kind, index, len(data), first_ns, second_ns) + data

    def _flush(self) -> None:
        """Hand over as much as the pipe takes, and wait for room only if some is left."""
        try:
            while self._reports:
                sent = os.write(self._reports_fd, self._reports[:PIPE_BYTES])
                del self._reports[:sent]
        except BlockingIOError:
            self._poll.register(self._reports_fd, select.POLLOUT)
            return
        except OSError:
            self._reports.clear()  # nobody reads; the orders' pipe will tell the same
        with contextlib.suppress(KeyError):
            self._poll.unregister(self._reports_fd)

    def _say_farewell(self) -> None:
        for port in self._ports.values():
            if port.farewell and not port.gone:
                _write_out(port.fd, port.farewell)


def _write_out(fd: int, data: bytes) -> None:
    """Write what a stuck port takes within half a second."""
    poll = select.poll()
    poll.register(fd, select.POLLOUT)
    end_ns = raw_ns() + int(FAREWELL_S * 1e9)
    while data and raw_ns() < end_ns:
        poll.poll(50)
        with contextlib.suppress(BlockingIOError):
            try:
                data = data[os.write(fd, data) :]
            except BlockingIOError:
                raise
            except OSError:
                return


def _open_all(wanted: list[tuple[str, int, str]], reports_fd: int) -> list[_Port] | None:
    ports: list[_Port] = []
    for index, (path, baud, farewell) in enumerate(wanted):
        try:
            ports.append(_Port(index, open_port(path, baud), farewell.encode("ascii")))
        except RefusedError as fault:
            # Nothing will be done here then, but what an earlier program left turning ends.
            for port in ports:
                _write_out(port.fd, port.farewell)
            text = f"{fault.reason}\n{fault}".encode()
            os.write(reports_fd, wire.REPORT.pack(wire.REFUSED, index, len(text), 0, 0) + text)
            return None
    return ports


def main() -> int:
    """Run on the ports named in the only argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the daemon decides when it is over
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    orders_fd, reports_fd = 0, 1
    with contextlib.suppress(OSError):
        fcntl.fcntl(reports_fd, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    ports = _open_all(json.loads(sys.argv[1]), reports_fd)
    if ports is None:
        return 1
    os.set_blocking(reports_fd, False)
    gc.freeze()
    gc.disable()  # nothing here makes cycles
    Acquisition(ports, orders_fd, reports_fd).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
