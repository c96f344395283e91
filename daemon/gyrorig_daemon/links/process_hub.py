"""`AcquisitionHub`: the ports of a real rig, in real time, behind the acquisition process."""

import contextlib
import json
import os
import select
import subprocess
import sys
from collections import deque
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import NoReturn

from gyrorig_daemon.links import wire
from gyrorig_daemon.links.acquire import PIPE_BYTES
from gyrorig_daemon.links.farewell import say_farewell
from gyrorig_daemon.links.hub import Chunk, PortChange, PortsGoneError, WriteStamp
from gyrorig_daemon.links.port_kinds import SERIAL, PortSettings
from gyrorig_daemon.links.raw_clock import raw_ns
from gyrorig_daemon.links.serial_port import candidates
from gyrorig_daemon.links.supervised_port import RETRY_NS
from gyrorig_protocol.errors import BusyError, DeviceError, GyrorigError, MachineError, UsageError

__all__ = ["AcquisitionHub", "PortSettings", "refusal"]

WRITE_DEADLINE_NS = 500_000_000  # a port that takes nothing holds up all others so long
REPORT_DEADLINE_NS = 4_000_000_000
OPEN_DEADLINE_NS = 15_000_000_000
CLOSE_DEADLINE_S = 2.0
RETRY_S = RETRY_NS * 1e-9


class AcquisitionHub:
    """A `PortHub` over real ports. Use it as a context, or close it."""

    def __init__(
        self, ports: dict[str, PortSettings], waits: bool = False, retry_s: float = RETRY_S
    ) -> None:
        """Open the ports in the acquisition process.

        A port that goes away later is tried again for ever, whatever `waits` says.

        Args:
            ports: settings by the names that chunks and writes use.
            waits: begin without the ports that are not there, not permitted yet, or broken;
                each of them is GONE until it can be opened.
            retry_s: how long on average until a port that is gone is tried again.

        Raises:
            UsageError: there is no such port; the text names those there are.
            BusyError: another program holds a port.
            DeviceError: an adapter is there and does not answer its driver.
            MachineError: no permission, or the process did not start.
        """
        self._names = list(ports)
        self._settings = list(ports.values())
        self._index = {name: index for index, name in enumerate(self._names)}
        self._parser = wire.ReportParser()
        self._reports: deque[wire.Report] = deque()
        self._chunks: deque[Chunk] = deque()
        self._down: set[str] = set()
        self._gone: str | None = None  # why nothing can be said any more
        self.dropped_bytes = 0
        # When anything last came from the acquisition process, which answers every ping. Not
        # when it wrote it: we may be late, and its answer lies behind all that it read before.
        self.answered_ns = raw_ns()
        self._refuse_twins()
        wanted = {
            "waits": waits,
            "pause_ns": int(retry_s * 1e9),
            "ports": [asdict(s) for s in self._settings],
        }
        try:
            self._child = subprocess.Popen(  # noqa: S603 - our own module, our own interpreter
                [sys.executable, "-m", "gyrorig_daemon.links.acquire", json.dumps(wanted)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,  # a Ctrl-C at the terminal is for the daemon alone
            )
        except OSError as fault:
            raise MachineError(
                f"the acquisition process cannot be started: {fault.strerror}",
                "free memory, or end other processes, and start again",
            ) from fault
        if self._child.stdin is None or self._child.stdout is None:
            raise MachineError("the acquisition process has no pipes", "start again")
        self._orders_fd = self._child.stdin.fileno()
        self._reports_fd = self._child.stdout.fileno()
        try:
            self._wait_until_open()
        except GyrorigError:
            self.close()
            raise

    def __enter__(self) -> "AcquisitionHub":
        """Return the hub itself."""
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

    def write(self, port: str, data: bytes) -> WriteStamp:
        """Write all of `data`; what arrives meanwhile is kept for `read`.

        Raises:
            DeviceError: the port is gone, or did not take the bytes in half a second.
            PortsGoneError: the acquisition process is gone, or hangs.
        """
        deadline_ns = raw_ns() + WRITE_DEADLINE_NS
        index = self._index[port]
        order = wire.ORDER.pack(wire.WRITE, index, len(data), deadline_ns) + data
        self._send(order)
        while True:
            report = self._next_report(deadline_ns + REPORT_DEADLINE_NS)
            if report is None:
                self._child.kill()
                self._child.wait()
                self._lose_ports("the acquisition process did not answer and was ended")
            if report.port == index and report.kind == wire.WRITTEN:
                return WriteStamp(report.first_ns, report.second_ns)
            if report.port == index and report.kind == wire.FAULT:
                raise DeviceError(
                    f"{self._settings[index].path} ({port}) cannot be written: "
                    f"{report.data.decode(errors='replace')}",
                    "check the cable and that the device is on",
                )
            self._keep(report)

    def read(self, deadline_ns: int) -> Chunk | None:
        """Return the next chunk, None at the deadline.

        Raises:
            PortsGoneError: the acquisition process is gone.
        """
        while not self._chunks:
            report = self._next_report(deadline_ns)
            if report is None:
                return None
            self._keep(report)
            # What came in one piece is looked through at once, up to a port's going or coming.
            while self._reports and self._reports[0].kind == wire.CHUNK:
                self._keep(self._reports.popleft())
        return self._chunks.popleft()

    @property
    def at_hand(self) -> deque[Chunk]:
        """What has been read from the pipe and not been handed out; see `GatheringHub`."""
        return self._chunks

    def is_up(self, port: str) -> bool:
        """Return whether the port is open, by what the acquisition process has said."""
        return port not in self._down

    def reopen(self, port: str) -> None:
        """Let go of a port and open it anew; chunks GONE and BACK tell when.

        Raises:
            PortsGoneError: the acquisition process is gone.
        """
        self._send(wire.ORDER.pack(wire.REOPEN, self._index[port], 0, 0))

    def ping(self) -> None:
        """Have the acquisition process say something; `answered_ns` moves when it does.

        Raises:
            PortsGoneError: the acquisition process is gone.
        """
        self._send(wire.ORDER.pack(wire.PING, 0, 0, 0))

    def close(self) -> None:
        """End the acquisition process. Closing twice is no fault."""
        if self._child.stdin is None or self._child.stdin.closed:
            return
        with contextlib.suppress(OSError):
            os.write(self._orders_fd, wire.ORDER.pack(wire.CLOSE, 0, 0, 0))
        self._child.stdin.close()
        try:
            self._child.wait(CLOSE_DEADLINE_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        if self._child.stdout is not None:
            self._child.stdout.close()

    def _wait_until_open(self) -> None:
        report = self._next_report(raw_ns() + OPEN_DEADLINE_NS)
        if report is None:
            raise MachineError(
                f"the acquisition process did not start within {OPEN_DEADLINE_NS // 10**9} s",
                "the lines above are its own; without any the computer is overloaded: try again",
            )
        if report.kind != wire.REFUSED:
            self._keep(report)
            return
        reason, _, text = report.data.decode(errors="replace").partition("\n")
        raise refusal(self._names[report.port], self._settings[report.port].path, reason, text)

    def _refuse_twins(self) -> None:
        """Two names of one port are a mistake of the configuration, not a busy port."""
        seen: dict[tuple[str, Path], str] = {}
        for settings in self._settings:
            path = Path(settings.path)
            key = settings.kind, path.resolve() if settings.kind == SERIAL else path
            other = seen.setdefault(key, settings.path)
            if other != settings.path:
                raise UsageError(
                    f"{other} and {settings.path} are one port", "give each device its own port"
                )

    def _keep(self, report: wire.Report) -> None:
        name = self._names[report.port]
        if report.kind == wire.CHUNK:
            _, _, stamp_ns, late_ns, data = report
            self._chunks.append(Chunk(name, stamp_ns, data, None, "", late_ns))
        elif report.kind == wire.GONE:
            self._down.add(name)
            why = report.data.decode(errors="replace")
            self._chunks.append(Chunk(name, report.first_ns, b"", PortChange.GONE, why))
        elif report.kind == wire.BACK:
            self._down.discard(name)
            self._chunks.append(Chunk(name, report.first_ns, b"", PortChange.BACK))
        elif report.kind == wire.LOST:
            self.dropped_bytes += report.second_ns

    def _send(self, order: bytes) -> None:
        if self._gone is not None:
            raise PortsGoneError(self._gone)
        try:
            os.write(self._orders_fd, order)
        except OSError:
            self._child_is_gone()

    def _next_report(self, deadline_ns: int) -> wire.Report | None:
        while not self._reports:
            if self._gone is not None:
                raise PortsGoneError(self._gone)
            wait_s = max(0.0, (deadline_ns - raw_ns()) * 1e-9)
            ready, _, _ = select.select([self._reports_fd], [], [], wait_s)
            if not ready:
                return None
            data = os.read(self._reports_fd, PIPE_BYTES)
            if not data:
                self._child_is_gone()
            self.answered_ns = raw_ns()
            self._reports.extend(self._parser.feed(data))
        return self._reports.popleft()

    def _child_is_gone(self) -> NoReturn:
        """Say that the acquisition process has ended by itself.

        Raises:
            PortsGoneError: always.
        """
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(CLOSE_DEADLINE_S)
        self._lose_ports(f"the acquisition process ended (status {self._child.returncode})")

    def _lose_ports(self, why: str) -> NoReturn:
        """Say the farewells ourselves: the process that had the ports is no more.

        Raises:
            PortsGoneError: always.
        """
        self._gone = why
        wanted = [settings for settings in self._settings if settings.farewell]
        heard = [say_farewell(s.path, s.baud, s.farewell) for s in wanted]
        if not wanted:
            raise PortsGoneError(why, "start again")
        if all(heard):
            raise PortsGoneError(why, "the unit was told to halt and answered; start again")
        raise PortsGoneError(why, "the unit was told to halt and did not answer; look at it")


def refusal(port: str, path: str, reason: str, text: str) -> GyrorigError:
    """Return the error for a port that could not be opened, by who must act."""
    if reason == "busy":
        return BusyError(
            f"{path} ({port}) is busy: {text}",
            "end that program (`gyrorigd doctor` names it), or wait until it has ended",
        )
    if reason == "denied":
        return MachineError(
            f"{path} ({port}) may not be opened: {text}",
            "sudo usermod -aG dialout $USER, and log in again; `gyrorigd doctor` names the group",
        )
    if reason == "broken":
        return DeviceError(
            f"{path} ({port}) does not answer its driver: {text}", "plug the adapter in again"
        )
    there = candidates()
    hint = (
        f"name another in the rig's configuration; ports here: {', '.join(there)}"
        if there
        else "check the cable and the adapter (this computer shows no serial port)"
    )
    return UsageError(f"{path} ({port}) cannot be used: {text}", hint)
