"""`gyrorigd halt` stops the unit, whatever the state of the daemon, and reports it correctly."""

import fcntl
import json
import os
import resource
import signal
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from gyrorig_daemon.cli import run
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import PtuFaults, PtuSettings, RigSettings
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns
from gyrorig_daemon.halt import direct_ptu_line, standalone_halt
from gyrorig_daemon.halt.standalone_halt import TIMEOUT_S, halt_unit
from gyrorig_protocol.errors import DeviceError

GYRORIGD = (sys.executable, "-m", "gyrorig_daemon")
E46 = PtuSettings(baud=115200)
BOTH_TURN = b"PS100 TS31 PP3000 TP600 "  # 30 s and 19 s
MOVES_S = 60.0  # so long may a thread be kept from serving the unit
PAN_STEPS, TILT_STEPS = 3000, 600


class EmulatedRigThread:
    """An emulated rig on ptys, served in a thread; it may be put in motion beforehand."""

    def __init__(self, settings: PtuSettings, orders: bytes = b"", only_at: int = 0) -> None:
        self.rig = EmulatedRig(RigSettings(seed=1, ptu=settings), raw_now_ns())
        self.server = PtyServer(self.rig)
        self.port = self.server.paths["ptu"]
        self.board = self.server.paths["board:GY80-1"]
        self.moves = threading.Event()
        self.both = threading.Event()  # axes have made a step
        self.rests = threading.Event()  # again, after it has moved
        self.ramps = threading.Event()  # pan cannot stop at once
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self.server.run, args=(self._look,))
        if self.rig.ptu is None:
            raise AssertionError
        if orders:
            self.rig.ptu.receive(orders, raw_now_ns())
        if only_at:
            self._gate(only_at)

    def turning(self) -> bool:
        now_s = (raw_now_ns() - self.rig.origin_ns) * 1e-9
        return self.rig.stage.pan.is_moving(now_s) or self.rig.stage.tilt.is_moving(now_s)

    def steps(self) -> tuple[int, int]:
        now_s = (raw_now_ns() - self.rig.origin_ns) * 1e-9
        return self.rig.stage.pan.count(now_s), self.rig.stage.tilt.count(now_s)

    def halts(self) -> int:
        return [order[0] for order in self.rig.stage.pan.commands].count("halt")

    def _look(self) -> bool:
        if self.turning():
            self.moves.set()
        elif self.moves.is_set():
            self.rests.set()
        if all(self.steps()):
            self.both.set()
        now_s = (raw_now_ns() - self.rig.origin_ns) * 1e-9
        if abs(self.rig.stage.pan.state(now_s)[1]) > 300.0:
            self.ramps.set()
        return self._ended.is_set()

    def _gate(self, baud: int) -> None:
        """Let the unit hear only what is sent at one rate, as a real line does."""
        ptu, master = self.rig.ptu, self.server._ptys["ptu"].descriptor
        if ptu is None:
            raise AssertionError
        hear = ptu.receive
        speed = getattr(termios, f"B{baud}")

        def receive(data: bytes, at_ns: int) -> None:
            if termios.tcgetattr(master)[5] == speed:
                hear(data, at_ns)

        ptu.receive = receive  # type: ignore[method-assign]

    def __enter__(self) -> "EmulatedRigThread":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self.server.close()


@contextmanager
def scripted(answer: Callable[[bytes], bytes]) -> Iterator[str]:
    """A device on a pty that answers each read by `answer`; b"" asks for a spontaneous word."""
    master, slave = os.openpty()
    tty.setraw(slave)
    ended = threading.Event()

    def serve() -> None:
        os.set_blocking(master, False)
        while not ended.wait(0.005):
            data = b""
            with suppress(BlockingIOError):
                data = os.read(master, 4096)
            with suppress(BlockingIOError):
                os.write(master, answer(data))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        thread.join()
        os.close(slave)
        os.close(master)


def rig_yaml(folder: Path, port: str, board: str = "/dev/none", baud: int = 115200) -> str:
    path = folder / "rig.yaml"
    path.write_text(
        f"rig: system\nptu: {{port: {port}, baud: {baud}}}\n"
        f"boards: [{{id: B-1, port: {board}, baud: 460800}}]\n"
    )
    return str(path)


@pytest.mark.parametrize(
    "settings",
    [
        replace(E46, echo=True, verbose=True),
        replace(E46, echo=False, verbose=False, command_time_ms=20.0),
        replace(E46, dialect="d46", echo=True, verbose=False),
        replace(E46, dialect="d46", echo=False, verbose=True, command_time_ms=100.0, baud=9600),
    ],
    ids=["e46", "e46-terse", "d46-terse-echo", "d46-slow"],
)
def test_halted_in_motion(
    tmp_path: Path, settings: PtuSettings, capsys: pytest.CaptureFixture[str]
) -> None:
    with EmulatedRigThread(settings, BOTH_TURN) as unit:
        assert unit.both.wait(MOVES_S)
        config = rig_yaml(tmp_path, unit.port, baud=settings.baud)
        assert run(["halt", "--config", config, "--json"]) == 0
        assert not unit.turning()
        pan, tilt = unit.steps()
        assert 0 < pan < PAN_STEPS
        assert 0 < tilt < TILT_STEPS
    output = capsys.readouterr()
    assert json.loads(output.out) == {
        "halted": True,
        "port": unit.port,
        "baud": settings.baud,
        "pan_steps": pan,
        "tilt_steps": tilt,
    }
    assert output.err == ""


def test_success_is_reported_at_standstill_not_at_the_command(tmp_path: Path) -> None:
    # up to 770 steps/s and down again in 7.7 s
    slow_to_stop = replace(
        E46, base_speed_steps_s=50, speed_steps_s=2900, acceleration_steps_s2=200
    )
    with EmulatedRigThread(slow_to_stop, b"PP-3000 ") as unit:
        pan = unit.rig.stage.pan
        assert unit.ramps.wait(MOVES_S)
        begun = time.monotonic()
        stands = halt_unit(unit.port, (115200,))
        took_s = time.monotonic() - begun
        assert not unit.turning()
        assert stands.pan_steps == unit.steps()[0] > -3000
        (halted_s,) = [order[1] for order in pan.commands if order[0] == "halt"][:1]
        assert pan.rests_at_s() - halted_s > 0.25  # it ramped down, and was waited for
        assert took_s < TIMEOUT_S


def test_a_command_truncated_by_a_crash(tmp_path: Path) -> None:
    with EmulatedRigThread(
        E46, b"PS200 PP3000 PP-30"
    ) as unit:  # the writer died before the last 00
        assert unit.moves.wait(MOVES_S)
        halt_unit(unit.port, (115200,))
        assert not unit.turning()


def test_a_few_line_faults_are_tolerated() -> None:
    faults = PtuFaults(garbage_every=5, lose_byte_every=7)
    with EmulatedRigThread(replace(E46, faults=faults), BOTH_TURN) as unit:
        assert unit.moves.wait(MOVES_S)
        halt_unit(unit.port, (115200,))
        assert not unit.turning()


def test_halt_stops_a_unit_left_moving_by_killed_processes(
    tmp_path: Path,
) -> None:
    program = tmp_path / "program.yaml"
    program.write_text("name: p\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 4.0}\n")
    with EmulatedRigThread(replace(E46, command_time_ms=2.0)) as unit:
        config = rig_yaml(tmp_path, unit.port, unit.board)
        daemon = subprocess.Popen(
            [*GYRORIGD, "record", "--config", config, "--program", program, "--out", tmp_path]
        )
        assert unit.moves.wait(MOVES_S)
        children = Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children").read_text().split()
        both = [daemon.pid, *map(int, children)]
        assert len(both) == 2
        halts = unit.halts()
        for number in (signal.SIGSTOP, signal.SIGKILL):  # neither may see the other's end
            for pid in both:
                os.kill(pid, number)
        daemon.wait()
        assert unit.turning()
        ended = subprocess.run(
            [*GYRORIGD, "halt", "--config", config], capture_output=True, text=True, check=False
        )
        assert (ended.returncode, ended.stderr) == (0, "")
        assert unit.halts() > halts
        assert not unit.turning()
        pan, tilt = unit.steps()
        assert 0 < pan < 2917
        assert ended.stdout == (
            f"The unit on {unit.port} has stopped at pan {pan}, tilt {tilt} steps (115200 baud).\n"
        )


def test_a_recording_refused_for_a_missing_board_halts_the_unit_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "program.yaml"
    program.write_text("name: p\nsteps:\n  - rest: {seconds: 1.0}\n")
    with EmulatedRigThread(E46, BOTH_TURN) as unit:
        assert unit.moves.wait(MOVES_S)
        config = rig_yaml(tmp_path, unit.port)
        arguments = ["record", "--config", config, "--program", str(program)]
        assert run([*arguments, "--out", str(tmp_path / "out")]) == 1
        assert unit.rests.wait(MOVES_S)
        assert unit.steps()[0] < PAN_STEPS  # where it would have come to rest by itself
    assert "the port /dev/none (board:B-1) does not exist" in capsys.readouterr().err


def test_another_baud_rate_than_configured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        standalone_halt, "OTHER_BAUD_ANSWER_S", 1.5
    )  # this machine may have other work
    with EmulatedRigThread(replace(E46, baud=19200), BOTH_TURN, only_at=19200) as unit:
        assert unit.moves.wait(MOVES_S)
        assert run(["halt", "--config", rig_yaml(tmp_path, unit.port)]) == 0
        assert not unit.turning()
    assert capsys.readouterr().out.endswith("(19200 baud, not 115200).\n")


def test_a_silent_port_ends_within_seconds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with scripted(lambda _: b"") as port:
        begun = time.monotonic()
        assert run(["halt", "--config", rig_yaml(tmp_path, port)]) == 1
        assert time.monotonic() - begun < TIMEOUT_S
    errors = capsys.readouterr().err
    assert "nothing answers" in errors
    assert "Check that the unit has stopped" in errors
    assert errors.count("\n") == 1


def test_other_devices_are_distinguished(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standalone_halt, "FIRST_ANSWER_S", 0.2)
    monkeypatch.setattr(direct_ptu_line, "DRAIN_S", 0.1)
    with (
        EmulatedRigThread(E46) as rig,
        pytest.raises(DeviceError, match="does not answer like a pan-tilt unit"),
    ):
        halt_unit(rig.board, (460800,))
    noise = bytes(range(256)) * 2
    with (
        scripted(lambda _: noise) as port,
        pytest.raises(DeviceError, match="does not answer like a pan-tilt"),
    ):
        halt_unit(port, (9600,))
    with scripted(lambda sent: sent) as port, pytest.raises(DeviceError, match="only returns"):
        halt_unit(port, (9600,))


def test_a_unit_that_does_not_stop() -> None:
    answers = {b"V": b"* Pan-Tilt v1.90.0(D46 C14/E)", b"H": b"*"}
    steps = iter(range(10**6))

    def answer(sent: bytes) -> bytes:
        words = (answers.get(word) or b"* %d" % next(steps) for word in sent.split())
        return b"".join(word + b"\r\n" for word in words)

    with scripted(answer) as port, pytest.raises(DeviceError, match="do not show that it stopped"):
        halt_unit(port, (9600,), timeout_s=4.0)


def test_a_unit_that_refuses() -> None:
    def answer(sent: bytes) -> bytes:
        known = {b"V": b"* Pan-Tilt v1.90.0(D46 C14/E)"}
        words = (known.get(word, b"! Illegal Command Entered") for word in sent.split())
        return b"".join(word + b"\r\n" for word in words)

    with scripted(answer) as port, pytest.raises(DeviceError, match="does not acknowledge"):
        halt_unit(port, (9600,))


def test_a_port_that_is_unplugged() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    tty.setraw(slave)

    def hang_up() -> None:
        os.read(master, 1)  # somebody has opened it, and told it to halt
        os.close(master)

    thread = threading.Thread(target=hang_up)
    thread.start()
    with pytest.raises(DeviceError, match="unplugged"):
        halt_unit(path, (9600,))
    thread.join()
    os.close(slave)


@pytest.mark.parametrize(
    ("text", "more", "code", "words"),
    [
        ("ptu: {port: /dev/none}\n", (), 1, "not halted, because the port /dev/none (ptu)"),
        ("ptu: {port: /dev/none, baud: 9600}\nboards: 3\n", (), 1, "/dev/none (ptu) does not"),
        ("ptu:\n  port: /dev/none # cable\n  baud: 9600\nboards: [}\n", (), 1, "/dev/none (ptu)"),
        ("ptu:\n  # port: /dev/old\n  port: '/dev/none'\nboards: [}\n", (), 1, "/dev/none (ptu)"),
        ("boards: [{port: /dev/x}]\n", (), 2, "does not contain the port of the pan-tilt"),
        ("ptu:\nboards: [{port: /dev/x]\n", (), 2, "does not contain the port of the pan-tilt"),
        ("ptu: {port: [1]}\n", ("--port", "/dev/none2"), 1, "/dev/none2 (ptu) does not exist"),
        ("\x00*b\n", ("--port", "/dev/null"), 2, "it is not a serial port"),
        ("", ("--baud", "1"), 2, "--help"),
    ],
)
def test_configurations_that_are_broken(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: str,
    more: tuple[str, ...],
    code: int,
    words: str,
) -> None:
    (tmp_path / "rig.yaml").write_text(text)
    assert run(["halt", "--config", str(tmp_path / "rig.yaml"), *more]) == code
    errors = capsys.readouterr().err
    assert words in errors
    assert errors.count("\n") == 1


def test_no_configuration_at_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["halt"]) == 2
    assert "Give the rig file with --config" in capsys.readouterr().err
    assert run(["halt", "--config", str(tmp_path / "none.yaml")]) == 2
    assert "cannot be read" in capsys.readouterr().err
    with EmulatedRigThread(replace(E46, baud=9600), BOTH_TURN) as unit:
        assert run(["halt", "--config", str(tmp_path / "none.yaml"), "--port", unit.port]) == 0
        assert not unit.turning()


def test_an_emulated_unit_needs_no_halt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["halt", "--config", rig_yaml(tmp_path, "emulated")]) == 0
    assert "so there is nothing to halt" in capsys.readouterr().out


def test_a_port_that_another_program_holds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standalone_halt, "BUSY_TIMEOUT_S", 0.1)
    with scripted(lambda _: b"") as port:
        held = os.open(port, os.O_RDWR | os.O_NOCTTY)
        fcntl.flock(held, fcntl.LOCK_EX)
        assert run(["halt", "--config", rig_yaml(tmp_path, port)]) == 75
        os.close(held)
    errors = capsys.readouterr().err
    assert f"process {os.getpid()}" in errors
    assert errors.count("\n") == 1


def test_it_imports_little() -> None:
    """Python's own library and a few files of ours: a blink to start, little that may be broken."""
    loaded = "print(*sys.modules)"
    halting = f"import sys; from gyrorig_daemon.cli import run; run(sys.argv[1:]); {loaded}"
    config = str(Path(__file__).parents[2] / "config" / "rig-raspberrypi.yaml")

    def modules(script: str, *arguments: str) -> set[str]:
        command = [sys.executable, "-c", script, *arguments]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        return set(ended.stdout.split())

    bare = modules(f"import sys; {loaded}")
    assert bare
    read_yaml = modules("import sys, msgspec, yaml, typing_extensions; print(*sys.modules)")
    for words, known, most in (
        (["--port", "/dev/none"], set[str](), 140),
        (["--config", config], read_yaml, 190),
    ):
        added = modules(halting, "halt", *words) - bare
        ours = {name for name in added if name.startswith("gyrorig_")}
        roots = {name.partition(".")[0] for name in added - ours - known}
        assert ours
        assert roots - sys.stdlib_module_names == {"click"}
        assert len(added) < most, sorted(added)


@pytest.mark.bench
def test_it_starts_quickly() -> None:
    """On a machine that does nothing else: processor time, where others run too, tells of them."""
    config = str(Path(__file__).parents[2] / "config" / "rig-raspberrypi.yaml")
    spent_s: list[float] = []
    while len(spent_s) < 5 and min(spent_s, default=1.0) >= 0.15:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [*GYRORIGD, "halt", "--config", config], stderr=subprocess.DEVNULL, check=False
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent_s.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    sys.stdout.write(f"halting a port that is not there: {min(spent_s):.3f} s of processor time\n")
    assert min(spent_s) < 0.15
