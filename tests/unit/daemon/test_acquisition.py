"""The acquisition process on pseudo-terminals: bytes, timestamps, locks, unplugging."""

import errno
import fcntl
import os
import pty
import select
import signal
import socket
import subprocess
import sys
import termios
import time
import tty
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from gyrorig_daemon.links.can.multicast_line import MulticastLine
from gyrorig_daemon.links.ports.acquisition import Acquisition
from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub, PortSettings
from gyrorig_daemon.links.ports.acquisition_pipe import CHUNK, REPORT_HEADER, ReportParser
from gyrorig_daemon.links.ports.port_errors import port_error
from gyrorig_daemon.links.ports.port_hub import Chunk, PortChange, PortsGoneError
from gyrorig_daemon.links.ports.raw_clock import raw_ns
from gyrorig_daemon.links.ports.report_queue import GATHER_NS, PIPE_BYTES
from gyrorig_daemon.links.ports.serial_port import PortRefusedError, open_port
from gyrorig_daemon.links.ports.supervised_port import SupervisedPort
from gyrorig_daemon.links.pump import Pump
from gyrorig_protocol.can import CanFrame, pack_frames, unpack_frames
from gyrorig_protocol.errors import BusyError, DeviceError, MachineError, UsageError

SECOND_NS = 1_000_000_000
PATIENCE_S = 60.0
PATIENCE_NS = 60 * SECOND_NS
TIOCGEXCL = 0x80045440  # <asm-generic/ioctls.h>


class Line:
    """A pty: our end is the device's, `path` the daemon's."""

    def __init__(self) -> None:
        self.fd, held = pty.openpty()
        self.path = os.ttyname(held)
        self.held = held

    def read(self, seconds: float = PATIENCE_S) -> bytes:
        ready, _, _ = select.select([self.fd], [], [], seconds)
        return os.read(self.fd, 4096) if ready else b""

    def close(self) -> None:
        for fd in (self.fd, self.held):
            with suppress(OSError):
                os.close(fd)


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.close()


def test_bytes_pass_unchanged_with_timestamps(line: Line) -> None:
    every = bytes(range(256))
    with AcquisitionHub({"a": PortSettings(line.path, 115200)}) as hub:
        before_ns = raw_ns()
        os.write(line.fd, every)
        got = b""
        while len(got) < len(every):
            chunk = hub.read(raw_ns() + PATIENCE_NS)
            assert chunk is not None
            assert chunk.port == "a"
            assert before_ns < chunk.received_ns < raw_ns()
            got += chunk.data
        assert got == every
        stamp = hub.write("a", every)
        assert before_ns < stamp.before_ns <= stamp.after_ns < raw_ns()
        seen = b""
        while len(seen) < len(every):
            seen += line.read()
        assert seen == every
        assert hub.read(raw_ns()) is None


def test_a_nonstandard_baud_rate(line: Line) -> None:
    with AcquisitionHub({"a": PortSettings(line.path, 250000)}) as hub:
        hub.write("a", b"x\r\n")
        assert line.read() == b"x\r\n"


def test_a_port_of_another_program_is_busy(line: Line) -> None:
    with (
        AcquisitionHub({"a": PortSettings(line.path, 9600)}),
        pytest.raises(BusyError, match=line.path) as caught,
    ):
        AcquisitionHub({"b": PortSettings(line.path, 9600)})
    assert caught.value.exit_code == 75


def test_the_port_is_locked_with_flock(line: Line) -> None:
    with AcquisitionHub({"a": PortSettings(line.path, 9600)}):
        fd = os.open(line.path, os.O_RDWR | os.O_NOCTTY)  # root is let in by TIOCEXCL
        with pytest.raises(BlockingIOError):
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        assert termios.tcgetattr(fd)[3] & (termios.ECHO | termios.ICANON) == 0
        os.close(fd)


def test_a_missing_port_is_a_device_error() -> None:
    with pytest.raises(DeviceError, match="/dev/none-such"):
        AcquisitionHub({"ptu": PortSettings("/dev/none-such", 9600)})


def test_two_names_of_one_port_are_rejected(line: Line, tmp_path: Path) -> None:
    (tmp_path / "unit").symlink_to(line.path)
    settings = [PortSettings(path, 9600) for path in (line.path, str(tmp_path / "unit"))]
    with pytest.raises(UsageError, match="are the same port"):
        AcquisitionHub(dict(zip(("ptu", "board:A"), settings, strict=True)))


def test_a_file_is_not_a_port(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(UsageError, match="not a serial port"):
        AcquisitionHub({"ptu": PortSettings(str(path), 9600)})


def test_an_unplugged_port_gives_an_empty_chunk_and_writes_fail(line: Line) -> None:
    with AcquisitionHub({"a": PortSettings(line.path, 9600)}) as hub:
        line.close()
        chunk = hub.read(raw_ns() + PATIENCE_NS)
        assert chunk is not None
        assert (chunk.data, chunk.change) == (b"", PortChange.GONE)
        assert not hub.is_up("a")
        with pytest.raises(DeviceError, match="unplugged"):
            hub.write("a", b"PP ")


class Cable:
    """A link to a pty, as udev's to a port: pulled and plugged in again."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.line: Line | None = None

    def plug(self) -> Line:
        self.line = Line()
        self.link.symlink_to(self.line.path)
        return self.line

    def pull(self) -> None:
        if self.line is not None:
            self.link.unlink()
            self.line.close()
        self.line = None


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    made = Cable(tmp_path / "port")
    yield made
    made.pull()


def next_change(hub: AcquisitionHub, change: PortChange) -> Chunk:
    """Read on until a port changes so."""
    end_ns = raw_ns() + PATIENCE_NS
    while (chunk := hub.read(end_ns)) is not None:
        if chunk.change is change:
            return chunk
    raise AssertionError(f"no port is {change.value}")


def test_a_port_that_is_plugged_in_later(line: Line, cable: Cable) -> None:
    ports = {"a": PortSettings(line.path, 9600), "b": PortSettings(str(cable.link), 9600)}
    with AcquisitionHub(ports, wait_for_ports=True, retry_s=0.2) as hub:
        gone = next_change(hub, PortChange.GONE)
        assert (gone.port, gone.text) == ("b", "No such file or directory")
        assert (hub.is_up("a"), hub.is_up("b")) == (True, False)
        with pytest.raises(DeviceError, match="unplugged"):
            hub.write("b", b"x")
        hub.write("a", b"x")
        later = cable.plug()
        assert next_change(hub, PortChange.BACK).port == "b"
        assert hub.is_up("b")
        hub.write("b", b"hello")
        assert later.read() == b"hello"


def test_a_port_that_is_replugged_repeatedly(line: Line, cable: Cable) -> None:
    device = cable.plug()
    ports = {"a": PortSettings(line.path, 9600), "b": PortSettings(str(cable.link), 9600)}
    with AcquisitionHub(ports, retry_s=0.2) as hub:
        for _ in range(2):
            cable.pull()
            gone = next_change(hub, PortChange.GONE)
            assert (gone.port, gone.text) == ("b", "it was unplugged")
            os.write(line.fd, b"goes on")
            chunk = hub.read(raw_ns() + PATIENCE_NS)
            assert chunk is not None
            assert (chunk.port, chunk.data) == ("a", b"goes on")
            device = cable.plug()
            back = next_change(hub, PortChange.BACK)
            assert back.received_ns > gone.received_ns
            os.write(device.fd, b"here")
            chunk = hub.read(raw_ns() + PATIENCE_NS)
            assert chunk is not None
            assert (chunk.port, chunk.data) == ("b", b"here")


def test_a_port_can_be_reopened(line: Line) -> None:
    # At once: the pause of a port that is lost would outlast every patience here.
    with AcquisitionHub({"a": PortSettings(line.path, 9600)}, retry_s=3600.0) as hub:
        hub.reopen("a")
        assert next_change(hub, PortChange.GONE).text == "it is opened again"
        assert not hub.is_up("a")
        next_change(hub, PortChange.BACK)
        hub.write("a", b"x")
        assert line.read() == b"x"


def test_a_stuck_port_can_be_reopened(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "gyrorig_daemon.links.ports.acquisition_hub.WRITE_DEADLINE_NS", SECOND_NS // 5
    )
    with AcquisitionHub({"a": PortSettings(line.path, 9600)}) as hub:
        with pytest.raises(DeviceError, match="takes no bytes"):
            hub.write("a", bytes(200_000))
        hub.reopen("a")
        next_change(hub, PortChange.BACK)


def test_a_busy_port_is_not_waited_for(line: Line) -> None:
    with (
        AcquisitionHub({"a": PortSettings(line.path, 9600)}),
        pytest.raises(BusyError, match=line.path),
    ):
        AcquisitionHub({"b": PortSettings(line.path, 9600)}, wait_for_ports=True)


def test_a_changed_reason_is_reported_again(cable: Cable, tmp_path: Path) -> None:
    with AcquisitionHub(
        {"b": PortSettings(str(cable.link), 9600)}, wait_for_ports=True, retry_s=0.2
    ) as hub:
        assert next_change(hub, PortChange.GONE).text == "No such file or directory"
        (tmp_path / "file").touch()
        cable.link.symlink_to(tmp_path / "file")
        assert next_change(hub, PortChange.GONE).text == "it is not a serial port"
        cable.link.unlink()


def test_a_write_to_a_stuck_port_fails(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "gyrorig_daemon.links.ports.acquisition_hub.WRITE_DEADLINE_NS", SECOND_NS // 5
    )
    with (
        AcquisitionHub({"a": PortSettings(line.path, 9600)}) as hub,
        pytest.raises(DeviceError, match="takes no bytes"),
    ):
        hub.write("a", bytes(200_000))


KILLED = """
import os, signal, sys
from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub, PortSettings
hub = AcquisitionHub({"a": PortSettings(sys.argv[1], 9600, " H ")})
os.kill(os.getpid(), signal.SIGKILL)  # a daemon that is killed without a word
"""


def test_when_the_daemon_dies_the_unit_is_halted(line: Line) -> None:
    ended = subprocess.run([sys.executable, "-c", KILLED, line.path], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert line.read() == b" H "


def test_when_the_acquisition_dies_the_daemon_halts_the_unit(line: Line) -> None:
    with AcquisitionHub({"a": PortSettings(line.path, 9600, " H ")}) as hub:
        hub._child.kill()
        with pytest.raises(MachineError, match="acquisition process ended"):
            hub.read(raw_ns() + PATIENCE_NS)
    assert line.read() == b" H "


def test_closing_sends_no_final_command(line: Line) -> None:
    with AcquisitionHub({"a": PortSettings(line.path, 9600, " H ")}) as hub:
        hub.write("a", b"V ")
    assert line.read() == b"V "
    assert line.read(0.05) == b""


@pytest.mark.parametrize("cut", range(1, REPORT_HEADER.size + 4))
def test_reports_do_not_depend_on_cuts(cut: int) -> None:
    stream = b"".join(
        REPORT_HEADER.pack(CHUNK, 0, len(data), at, 0) + data
        for at, data in enumerate((b"abc", b"", b"\0" * 300))
    )
    whole = ReportParser().feed(stream)
    parser = ReportParser()
    pieces = [stream[at : at + cut] for at in range(0, len(stream), cut)]
    assert [report for piece in pieces for report in parser.feed(piece)] == whole
    assert len(whole) == 3


def test_a_pty_stays_usable_for_the_next_program(line: Line) -> None:
    with AcquisitionHub({"a": PortSettings(line.path, 9600)}):
        alone = fcntl.ioctl(line.held, TIOCGEXCL, b"\0\0\0\0")
    assert alone == b"\0\0\0\0"  # it would stay as long as our end is open


def test_a_port_that_another_holds_exclusively_is_busy(line: Line) -> None:
    fcntl.ioctl(line.held, termios.TIOCEXCL)
    with pytest.raises(BusyError, match=line.path):
        AcquisitionHub({"a": PortSettings(line.path, 9600)})


def test_a_hanging_acquisition_is_killed_and_the_unit_halted(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "gyrorig_daemon.links.ports.acquisition_hub.REPORT_DEADLINE_NS", SECOND_NS // 5
    )
    monkeypatch.setattr("gyrorig_daemon.links.ports.halt_on_disconnect.ANSWER_TIMEOUT_S", 0.05)
    with AcquisitionHub({"a": PortSettings(line.path, 9600, " H ")}) as hub:
        hub._child.send_signal(signal.SIGSTOP)
        with pytest.raises(PortsGoneError, match="did not respond and was killed"):
            hub.write("a", b"V ")
        assert line.read() == b" H "
        for again in (lambda: hub.write("a", b"V "), lambda: hub.read(raw_ns())):
            with pytest.raises(PortsGoneError):
                again()


def test_chunks_are_collected_with_their_timestamps_and_replies_are_sent_at_once(
    line: Line, cable: Cable
) -> None:
    unit = cable.plug()
    ports = {
        "board": PortSettings(line.path, 9600),
        "unit": PortSettings(str(cable.link), 9600, " H "),
    }
    with AcquisitionHub(ports) as hub:
        stamps = []
        for number in range(20):
            os.write(line.fd, b"%02d" % number)
            time.sleep(0.0005)
        got = b""
        while len(got) < 40:
            chunk = hub.read(raw_ns() + PATIENCE_NS)
            assert chunk is not None
            got += chunk.data
            stamps.append(chunk.received_ns)
        assert got == b"".join(b"%02d" % number for number in range(20))
        assert stamps == sorted(set(stamps))
        # On a machine with other work most of them come late; kept waiting, every one would.
        waits_ns = [GATHER_NS]
        while min(waits_ns) >= GATHER_NS // 2:
            assert len(waits_ns) < 2_000
            os.write(unit.fd, b"*\r\n")
            chunk = hub.read(raw_ns() + PATIENCE_NS)
            assert chunk is not None
            waits_ns.append(raw_ns() - chunk.received_ns)


def test_nothing_is_lost_while_the_daemon_does_not_read(line: Line) -> None:
    piece = bytes(range(256)) * 16
    settings = PortSettings(line.path, 115200, quota_bytes_per_s=1 << 40)
    with AcquisitionHub({"a": settings}) as hub:
        for _ in range(2):  # the pipe is full, and empty, and full again
            pieces = 2 * PIPE_BYTES // len(piece)
            for _ in range(pieces):
                rest = piece
                while rest:
                    rest = rest[os.write(line.fd, rest) :]
            got = 0
            while got < pieces * len(piece):
                chunk = hub.read(raw_ns() + PATIENCE_NS)
                assert chunk is not None
                assert chunk.data[0] == got % 256
                got += len(chunk.data)
        assert hub.dropped_bytes == 0


def windows(stamps_ns: list[int], length_ns: int) -> int:
    """How many readings take all that came, if each takes what came within so long."""
    count, first_ns = 0, -length_ns
    for stamp_ns in stamps_ns:
        if stamp_ns - first_ns >= length_ns:
            count, first_ns = count + 1, stamp_ns
    return count


def test_frames_of_a_bus_are_read_together_with_their_timestamps() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("239.74.163.8", 0))
        port = probe.getsockname()[1]
    path = f"udp_multicast:239.74.163.8:{port}@127.0.0.1"
    sender = MulticastLine("239.74.163.8", port, "127.0.0.1")
    with AcquisitionHub({"bus": PortSettings(path, 1_000_000, kind="can")}) as hub:
        for _ in range(100):  # until the sender was not kept from its turn too often
            for number in range(40):
                sender.write(pack_frames([CanFrame(0x80, bytes([number]))]))
                time.sleep(0.0005)
            frames: list[CanFrame] = []
            chunks = 0
            while len(frames) < 40:
                chunk = hub.read(raw_ns() + PATIENCE_NS)
                assert chunk is not None
                chunks += 1
                frames += unpack_frames(chunk.data, 0)
            assert [frame.data[0] for frame in frames] == list(range(40))
            stamps = [frame.timestamp_ns for frame in frames]
            assert stamps == sorted(stamps)
            # when they came, not when they were read
            assert stamps[-1] - stamps[0] > 39 * 500_000 * 0.8
            # a reading begins when its first frame has come, and the clocks' pairs scatter
            assert chunks <= windows(stamps, GATHER_NS * 9 // 10)
            if chunks < 30:
                break
        assert chunks < 30
    sender.close()


def test_chunks_that_arrive_together_are_delivered_together(line: Line) -> None:
    taken: list[bytes] = []
    with AcquisitionHub({"a": PortSettings(line.path, 115200)}) as hub:
        pump = Pump(hub)
        pump.attach("a", lambda chunk: taken.append(chunk.data))
        for number in range(200):
            os.write(line.fd, b"%03d" % number)
        end_ns = raw_ns() + PATIENCE_NS
        assert pump.run_until(end_ns, lambda: b"".join(taken)[:9] == b"000001002")
        assert pump.run_until(end_ns, lambda: len(b"".join(taken)) == 600)
        assert not hub.buffered_chunks
    assert b"".join(taken) == b"".join(b"%03d" % number for number in range(200))


def test_repeated_reopening_leaks_nothing(line: Line, cable: Cable) -> None:
    ports = {"a": PortSettings(line.path, 9600), "b": PortSettings(str(cable.link), 9600)}
    with AcquisitionHub(ports, wait_for_ports=True, retry_s=0.02) as hub:
        held = Path(f"/proc/{hub._child.pid}/fd")
        before: int | None = None
        for _ in range(30):
            hub.reopen("a")
            next_change(hub, PortChange.BACK)
            cable.plug()
            assert next_change(hub, PortChange.BACK).port == "b"
            cable.pull()
            assert next_change(hub, PortChange.GONE).port == "b"
            before = before or len(list(held.iterdir()))
        assert len(list(held.iterdir())) == before


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (errno.EIO, "broken"),
        (errno.EPROTO, "broken"),
        (errno.ENODEV, "missing"),
        (errno.EACCES, "denied"),
        (errno.EBUSY, "busy"),
        (errno.EISDIR, "foreign"),
    ],
)
def test_why_a_port_cannot_be_opened(
    monkeypatch: pytest.MonkeyPatch, number: int, reason: str
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("os.open", refuse)
    with pytest.raises(PortRefusedError, match=os.strerror(number)) as caught:
        open_port("/dev/ttyUSB9", 9600)
    assert caught.value.reason == reason


def test_an_adapter_that_fails_during_configuration(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise termios.error(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("termios.tcsetattr", refuse)
    with pytest.raises(PortRefusedError, match="cannot be configured") as caught:
        open_port(line.path, 9600)
    assert caught.value.reason == "broken"
    error = port_error("board:A", line.path, caught.value.reason, str(caught.value))
    assert isinstance(error, DeviceError)


def make_acquisition(settings: PortSettings) -> tuple[Acquisition, SupervisedPort, int]:
    """Return an acquisition that runs in this process, its closed port, and its reports."""
    port = SupervisedPort(0, settings)
    commands, reports, urgent = os.pipe(), os.pipe(), os.pipe()
    for descriptor in (*reports, *urgent):
        os.set_blocking(descriptor, False)
    acquisition = Acquisition([port], commands[0], reports[1], urgent[1], None, b"\0")
    return acquisition, port, reports[0]


def make_acquisition_on_pty() -> tuple[int, Acquisition, SupervisedPort]:
    """Return the end of a unit, which does not block, and an acquisition with the other end."""
    device, line = pty.openpty()
    tty.setraw(line)
    os.set_blocking(device, False)
    acquisition, port, _ = make_acquisition(PortSettings(os.ttyname(line), 9600, "H "))
    return device, acquisition, port


def test_a_unit_that_was_unplugged_while_the_daemon_was_silent_is_halted() -> None:
    """It gets the halt when its port is open again, because the daemon does not send it."""
    device, acquisition, port = make_acquisition_on_pty()
    acquisition._last_command_ns = raw_ns() - 4 * SECOND_NS
    acquisition._halt_if_silent(raw_ns())
    acquisition._retry_closed_ports()
    assert port.line is not None
    acquisition._halt_if_silent(raw_ns())
    select.select([device], [], [], PATIENCE_S)
    assert os.read(device, 100) == b"H "


def test_a_halted_unit_that_was_unplugged_is_halted_again_before_anything_else() -> None:
    """The daemon has not run yet, so its halt on the returned port would be refused."""
    device, acquisition, port = make_acquisition_on_pty()
    acquisition._retry_closed_ports()
    acquisition._last_command_ns = raw_ns() - 4 * SECOND_NS
    acquisition._halt_if_silent(raw_ns())
    select.select([device], [], [], PATIENCE_S)
    assert os.read(device, 100) == b"H "
    acquisition._drop_port(port, "it was unplugged", retry_now=True)
    acquisition._retry_closed_ports()
    acquisition._writes.accept(port, b"PP100 ", raw_ns() + SECOND_NS)  # of before the halt
    select.select([device], [], [], 5.0)
    assert os.read(device, 100) == b"H "


def test_a_unit_whose_port_is_closed_when_the_daemon_dies_is_halted() -> None:
    device, acquisition, _ = make_acquisition_on_pty()
    acquisition._send_final_commands()
    select.select([device], [], [], PATIENCE_S)
    assert os.read(device, 100) == b"H "


def test_bytes_before_and_after_a_loss_do_not_make_one_line() -> None:
    device, line = pty.openpty()
    tty.setraw(line)
    acquisition, port, reports = make_acquisition(
        PortSettings(os.ttyname(line), 9600, "", quota_bytes_per_s=20)
    )
    acquisition._retry_closed_ports()
    parser, hub = ReportParser(), object.__new__(AcquisitionHub)
    hub._names, hub._closed_ports, hub.dropped_bytes = ["b"], set(), 0
    chunks: deque[Chunk] = deque()

    def deliver(data: bytes) -> None:
        os.write(device, data)
        assert port.line is not None
        select.select([port.line.fd], [], [], PATIENCE_S)
        acquisition._read(port, False)
        acquisition._bulk.flush()

    deliver(b"1,2,3\n" * 8 + b"-1")  # more than the quota
    os.write(device, b"20,5,6\n10,-34")
    assert port.line is not None
    select.select([port.line.fd], [], [], PATIENCE_S)
    acquisition._unmute_ports(port.muted_until_ns)
    deliver(b"45,7,8\n11,12,13\n")
    for report in parser.feed(os.read(reports, PIPE_BYTES)):
        hub._store_report(report, chunks)
    delivered = [chunk for chunk in chunks if chunk.data or chunk.is_after_loss]
    assert [chunk.is_after_loss for chunk in delivered] == [False, True, False]
    assert delivered[2].data.startswith(b"45,7,8")
    assert hub.dropped_bytes == 13
