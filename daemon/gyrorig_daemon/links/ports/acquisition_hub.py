"""`AcquisitionHub`: the ports of a real rig in real time, through the acquisition process."""

import contextlib
import os
import select
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import NoReturn

from gyrorig_daemon.links.ports import acquisition_pipe
from gyrorig_daemon.links.ports.acquisition_child import (
    HANGS,
    KILL_DEADLINE_S,
    await_end,
    close_child,
    kill_child,
    start_child,
)
from gyrorig_daemon.links.ports.halt_on_disconnect import send_final_command
from gyrorig_daemon.links.ports.halt_pipe import HaltPipe
from gyrorig_daemon.links.ports.port_errors import port_error
from gyrorig_daemon.links.ports.port_hub import (
    Chunk,
    PortChange,
    PortsGoneError,
    UnitHaltedError,
    WriteTimes,
)
from gyrorig_daemon.links.ports.port_kinds import SERIAL, PortSettings
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.report_queue import PIPE_BYTES
from gyrorig_daemon.links.ports.supervised_port import RETRY_NS
from gyrorig_protocol.errors import DeviceError, GyrorigError, MachineError, UsageError

__all__ = ["AcquisitionHub", "PortSettings"]

WRITE_DEADLINE_NS = 500_000_000  # a port that takes no bytes delays all others by this
REPORT_DEADLINE_NS = 4_000_000_000
OPEN_DEADLINE_NS = 15_000_000_000
SPEAK_NS = 500_000_000  # three seconds of silence make the acquisition process halt the unit
RETRY_S = RETRY_NS * 1e-9


class AcquisitionHub:
    """A `PortHub` of real ports. Use it as a context manager, or close it."""

    def __init__(
        self,
        ports: dict[str, PortSettings],
        wait_for_ports: bool = False,
        retry_s: float = RETRY_S,
        halt_pipe: HaltPipe | None = None,
        on_problem: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Open the ports in the acquisition process.

        A port that goes away later is tried again without limit.

        Args:
            ports: settings by the names that chunks and writes use.
            wait_for_ports: start without ports that do not exist, are not permitted yet, or are
                broken; they are GONE until they can be opened.
            retry_s: mean time between two attempts to open a port.
            halt_pipe: orders for the acquisition process that do not pass through this hub.
            on_problem: gets a sentence if the acquisition process cannot be ended.

        Raises:
            UsageError: a path is not a serial port, or two names have the same port.
            BusyError: another program uses a port.
            DeviceError: a port does not exist, or an adapter does not answer its driver.
            MachineError: there is no permission, or the process did not start.
        """
        self._names = list(ports)
        self._settings = list(ports.values())
        self._index_by_name = {name: index for index, name in enumerate(self._names)}
        self._parser = acquisition_pipe.ReportParser()
        self._reports: deque[acquisition_pipe.AcquisitionReport] = deque()
        self._chunks: deque[Chunk] = deque()
        self._urgent_parser = acquisition_pipe.ReportParser()
        self._urgent_reports: deque[acquisition_pipe.AcquisitionReport] = deque()
        self._urgent_chunks: deque[Chunk] = deque()  # of the unit
        self._has_urgent_ended = False
        self._last_ping_ns = 0
        self._closed_ports: set[str] = set()
        self._end_reason: str | None = None  # why no port can be reached
        self.dropped_bytes = 0
        # When the acquisition process, which answers every ping, was last heard. Not when it
        # wrote: this process may be late, and the answer comes after all earlier reports.
        self.last_report_ns = raw_ns()
        self._reject_duplicate_ports()
        if halt_pipe is not None:
            halt_pipe.drain()  # orders of the time without an acquisition process
        self._on_problem = on_problem
        self._urgent_fd, urgent_write_fd = os.pipe2(os.O_CLOEXEC)
        os.set_blocking(self._urgent_fd, False)
        arguments = {
            "waits": wait_for_ports,
            "pause_ns": int(retry_s * 1e9),
            "ports": [asdict(s) for s in self._settings],
            "urgent_fd": urgent_write_fd,
            "halt_fd": None if halt_pipe is None else halt_pipe.read_fd,
            "halting_signals": [] if halt_pipe is None else sorted(halt_pipe.halting_signals),
        }
        passed_fds = (urgent_write_fd, *([] if halt_pipe is None else [halt_pipe.read_fd]))
        try:
            self._child, self._commands_fd, self._reports_fd = start_child(arguments, passed_fds)
        except MachineError:
            os.close(self._urgent_fd)
            raise
        finally:
            os.close(urgent_write_fd)
        try:
            self._wait_until_open()
        except GyrorigError:
            self.close()
            raise

    def __enter__(self) -> "AcquisitionHub":
        """Return the hub."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close every port."""
        self.close()

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC_RAW in ns."""
        return raw_ns()

    def write(self, port: str, data: bytes) -> WriteTimes:
        """Write all of `data`; what arrives meanwhile is kept for `read`.

        Raises:
            DeviceError: the port is gone, or did not take the bytes in half a second.
            PortsGoneError: the acquisition process ended or hangs.
        """
        deadline_ns = raw_ns() + WRITE_DEADLINE_NS
        index = self._index_by_name[port]
        command = (
            acquisition_pipe.COMMAND_HEADER.pack(
                acquisition_pipe.WRITE, index, len(data), deadline_ns
            )
            + data
        )
        self._send(command)
        while True:
            report = self._next_urgent_report(deadline_ns + REPORT_DEADLINE_NS)
            if report is None:
                reason = "the acquisition process did not respond and was killed"
                self._halt_and_raise(
                    reason if kill_child(self._child) else f"{reason}, but {HANGS}"
                )
            if report.port == index and report.kind == acquisition_pipe.WRITTEN:
                return WriteTimes(report.first_ns, report.second_ns)
            if report.port == index and report.kind == acquisition_pipe.FAULT:
                raise DeviceError(
                    f"the daemon cannot write to the port {self._settings[index].path} "
                    f"({port}): {report.data.decode(errors='replace')}",
                    "check the cable and the power of the device",
                )
            if report.port == index and report.kind == acquisition_pipe.HALTED:
                self._send(
                    acquisition_pipe.COMMAND_HEADER.pack(acquisition_pipe.RELEASE, index, 0, 0)
                )
                reason = report.data.decode(errors="replace")
                raise UnitHaltedError(reason, was_ordered=bool(report.second_ns))
            self._store_report(report, self._urgent_chunks)

    def read(self, deadline_ns: int) -> Chunk | None:
        """Return the next chunk, None at the deadline.

        Raises:
            PortsGoneError: the acquisition process ended.
        """
        self._speak()
        while True:
            self._receive_urgent()
            while self._urgent_reports:
                self._store_report(self._urgent_reports.popleft(), self._urgent_chunks)
            if self._urgent_chunks:
                chunk = self._urgent_chunks.popleft()
                return chunk._replace(is_early=True) if self._has_older_data() else chunk
            if self._chunks:
                return self._chunks.popleft()
            if not self._reports and not self._receive(deadline_ns):
                return None
            # Convert everything that arrived together, up to a change of a port.
            is_first = True
            while self._reports and (is_first or self._reports[0].kind == acquisition_pipe.CHUNK):
                self._store_report(self._reports.popleft(), self._chunks)
                is_first = False

    @property
    def buffered_chunks(self) -> deque[Chunk]:
        """Chunks that were received and not handed out. See `BufferedHub`."""
        return self._chunks

    def is_up(self, port: str) -> bool:
        """Return whether the port is open, according to the acquisition process."""
        return port not in self._closed_ports

    def reopen(self, port: str) -> None:
        """Close a port and open it again; chunks with GONE and BACK report it.

        Raises:
            PortsGoneError: the acquisition process ended.
        """
        self._send(
            acquisition_pipe.COMMAND_HEADER.pack(
                acquisition_pipe.REOPEN, self._index_by_name[port], 0, 0
            )
        )

    def ping(self) -> None:
        """Ask the acquisition process for a reply, which updates `last_report_ns`.

        Raises:
            PortsGoneError: the acquisition process ended.
        """
        self._send(acquisition_pipe.COMMAND_HEADER.pack(acquisition_pipe.PING, 0, 0, 0))

    def close(self) -> None:
        """End the acquisition process. It may be closed twice."""
        if self._child.stdin is None or self._child.stdin.closed:
            return
        with contextlib.suppress(OSError):
            os.write(
                self._commands_fd,
                acquisition_pipe.COMMAND_HEADER.pack(acquisition_pipe.CLOSE, 0, 0, 0),
            )
        if problem := close_child(self._child):
            self._on_problem(problem)
        os.close(self._urgent_fd)

    def _wait_until_open(self) -> None:
        deadline_ns = raw_ns() + OPEN_DEADLINE_NS
        while not self._reports and self._receive(deadline_ns):
            if not self._reports:
                self._receive_urgent()
        if not self._reports:
            raise MachineError(
                f"the acquisition process did not start within {OPEN_DEADLINE_NS // 10**9} s",
                "read the messages above. If there are none, the computer is overloaded, so "
                "try again later",
            )
        report = self._reports.popleft()
        if report.kind != acquisition_pipe.REFUSED:
            self._store_report(report, self._chunks)
            return
        reason, _, text = report.data.decode(errors="replace").partition("\n")
        raise port_error(self._names[report.port], self._settings[report.port].path, reason, text)

    def _reject_duplicate_ports(self) -> None:
        """Reject two names of one port: a mistake in the configuration, not a busy port."""
        path_by_key: dict[tuple[str, Path], str] = {}
        for settings in self._settings:
            path = Path(settings.path)
            key = settings.kind, path.resolve() if settings.kind == SERIAL else path
            first_path = path_by_key.setdefault(key, settings.path)
            if first_path != settings.path:
                raise UsageError(
                    f"the paths {first_path} and {settings.path} are the same port",
                    "give each device a different port in the rig file",
                )

    def _store_report(
        self, report: acquisition_pipe.AcquisitionReport, chunks: deque[Chunk]
    ) -> None:
        name = self._names[report.port]
        if report.kind == acquisition_pipe.CHUNK:
            _, _, stamp_ns, late_ns, data = report
            chunks.append(Chunk(name, stamp_ns, data, None, "", late_ns))
        elif report.kind == acquisition_pipe.GONE:
            self._closed_ports.add(name)
            reason = report.data.decode(errors="replace")
            chunks.append(Chunk(name, report.first_ns, b"", PortChange.GONE, reason))
        elif report.kind == acquisition_pipe.BACK:
            self._closed_ports.discard(name)
            chunks.append(Chunk(name, report.first_ns, b"", PortChange.BACK))
        elif report.kind == acquisition_pipe.DROPPED:
            self.dropped_bytes += report.second_ns
            chunks.append(Chunk(name, report.first_ns, b"", is_after_loss=True))

    def _send(self, command: bytes) -> None:
        if self._end_reason is not None:
            raise PortsGoneError(self._end_reason, "start the program again")
        try:
            os.write(self._commands_fd, command)
        except OSError:
            self._raise_process_ended()

    def _speak(self) -> None:
        """Show the acquisition process twice per second that the event loop runs."""
        now_ns = raw_ns()
        if now_ns - self._last_ping_ns > SPEAK_NS:
            self._last_ping_ns = now_ns
            self.ping()

    def _has_older_data(self) -> bool:
        """Return whether data of boards wait that can be older than those of the unit."""
        return bool(self._chunks or select.select([self._reports_fd], [], [], 0.0)[0])

    def _next_urgent_report(self, deadline_ns: int) -> acquisition_pipe.AcquisitionReport | None:
        while not self._urgent_reports:
            if self._has_urgent_ended:
                self._raise_process_ended()
            wait_s = max(0.0, (deadline_ns - raw_ns()) * 1e-9)
            if not select.select([self._urgent_fd], [], [], wait_s)[0]:
                return None
            self._receive_urgent()
        return self._urgent_reports.popleft()

    def _receive_urgent(self) -> None:
        """Read the reports of the unit's port and of writes; it does not wait."""
        if self._has_urgent_ended:
            return
        try:
            data = os.read(self._urgent_fd, PIPE_BYTES)
        except BlockingIOError:
            return
        if not data:
            self._has_urgent_ended = True  # what the other pipe still holds is read first
            return
        self.last_report_ns = raw_ns()
        self._urgent_reports.extend(self._urgent_parser.feed(data))

    def _receive(self, deadline_ns: int) -> bool:
        """Wait for reports of either pipe, and read those of boards; False at the deadline."""
        if self._end_reason is not None:
            raise PortsGoneError(self._end_reason, "start the program again")
        wait_s = max(0.0, (deadline_ns - raw_ns()) * 1e-9)
        sources = (
            [self._reports_fd] if self._has_urgent_ended else [self._reports_fd, self._urgent_fd]
        )
        ready, _, _ = select.select(sources, [], [], wait_s)
        if self._reports_fd in ready:
            data = os.read(self._reports_fd, PIPE_BYTES)
            if not data:
                self._raise_process_ended()
            self.last_report_ns = raw_ns()
            self._reports.extend(self._parser.feed(data))
        return bool(ready)

    def _raise_process_ended(self) -> NoReturn:
        """Report that the acquisition process has ended.

        Raises:
            PortsGoneError: always.
        """
        await_end(self._child, KILL_DEADLINE_S)
        self._halt_and_raise(f"the acquisition process ended (status {self._child.returncode})")

    def _halt_and_raise(self, reason: str) -> NoReturn:
        """Send the final commands from here, because the process that had the ports is gone.

        Raises:
            PortsGoneError: always.
        """
        self._end_reason = reason
        ports_to_halt = [settings for settings in self._settings if settings.final_command]
        answers = [send_final_command(s.path, s.baud, s.final_command) for s in ports_to_halt]
        if not ports_to_halt:
            raise PortsGoneError(reason, "start the program again")
        if all(answers):
            raise PortsGoneError(
                reason, "start the program again. The pan-tilt unit has confirmed the halt command"
            )
        raise PortsGoneError(
            reason,
            "check that the pan-tilt unit has stopped, because the unit did not confirm the halt "
            "command",
        )
