"""`gyrorigd doctor` on real ptys: what it finds of devices, and that it moves none."""

import contextlib
import fcntl
import json
import os
import subprocess
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.cli import run
from gyrorig_daemon.doctor import board_check as board_module
from gyrorig_daemon.doctor import unit_check as unit_module
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import (
    BoardFaults,
    BoardSettings,
    PtuSettings,
    RigSettings,
)
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns
from gyrorig_daemon.halt import direct_ptu_line
from gyrorig_protocol.board import Hello, Sample, Sensor
from gyrorig_protocol.errors import UsageError

E46 = PtuSettings(baud=115200)
BOARD = BoardSettings(name="B-1", odr_hz=400.0, bandwidth_hz=50.0)
HELLO = Hello(1, "1.0.0", "uno", "u-1", 3, (Sensor(who=211, full_scale=250.0, per_count=0.00875),))


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer rates and less to listen to than with real devices, but all patience with answers."""
    monkeypatch.setattr(board_module, "MEASURE_S", 0.5)
    monkeypatch.setattr(board_module, "USUAL_BAUDS", (460800, 115200))
    monkeypatch.setattr(unit_module, "USUAL_BAUDS", (9600, 115200))
    monkeypatch.setattr(direct_ptu_line, "DRAIN_S", 0.1)


@contextlib.contextmanager
def served(ptu: PtuSettings, *boards: BoardSettings, orders: bytes = b"") -> Iterator[EmulatedRig]:
    """An emulated rig on ptys; `rig.ports` is set to their paths."""
    rig = EmulatedRig(RigSettings(seed=1, ptu=ptu, boards=boards), raw_now_ns())
    server = PtyServer(rig)
    if rig.ptu is None:
        raise AssertionError
    rig.ptu.receive(orders, raw_now_ns())
    ended = threading.Event()
    thread = threading.Thread(target=server.run, args=(ended.is_set,))
    thread.start()
    PATHS.clear()
    PATHS.update(server.paths)
    try:
        yield rig
    finally:
        ended.set()
        thread.join()
        server.close()


PATHS: dict[str, str] = {}


@contextlib.contextmanager
def device(answer: Callable[[bytes, int], bytes]) -> Iterator[str]:
    """A device that is told what was written, and the line's speed, 100 times a second."""
    master, slave = os.openpty()
    tty.setraw(slave)
    ended = threading.Event()

    def serve() -> None:
        os.set_blocking(master, False)
        while not ended.wait(0.01):
            data = b""
            with contextlib.suppress(BlockingIOError):
                data = os.read(master, 4096)
            with contextlib.suppress(BlockingIOError):
                os.write(master, answer(data, termios.tcgetattr(master)[5]))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        thread.join()
        os.close(slave)
        os.close(master)


def rig_yaml(folder: Path, unit: str, *boards: str, more: str = "") -> Path:
    path = folder / "rig.yaml"
    listed = ", ".join(
        f"{{id: B-{number}, port: {port}, baud: 460800}}" for number, port in enumerate(boards, 1)
    )
    path.write_text(f"rig: r\nptu: {{port: {unit}, baud: 115200{more}}}\nboards: [{listed}]\n")
    return path


def doctor(
    config: Path, capsys: pytest.CaptureFixture[str], *more: str
) -> tuple[int, dict[str, dict[str, Any]]]:
    """Return the exit code, and the findings by subject and code."""
    code = run(["doctor", "--config", str(config), "--out", str(config.parent), "--json", *more])
    document = json.loads(capsys.readouterr().out)
    for finding in document["findings"]:
        assert finding["remedy"] or finding["level"] in ("ok", "note")
    return code, {f"{f['subject']} {f['code']}": f for f in document["findings"]}


def test_a_sound_rig_is_left_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with served(E46, BOARD, orders=b"PS200 PP3000 ") as rig:
        config = rig_yaml(tmp_path, PATHS["ptu"], PATHS["board:B-1"])
        code, findings = doctor(config, capsys)
        now_s = (raw_now_ns() - rig.origin_ns) * 1e-9
        assert rig.stage.pan.is_moving(now_s)  # whoever moves it is not disturbed
        assert [order[0] for order in rig.stage.pan.commands].count("halt") == 0
    assert code in (0, 4)  # this computer may have its own flaws
    assert "PTU-E46-17.5, serial E46-0001, firmware 3.4.2r0" in findings["unit identity"]["what"]
    assert "at 115200 baud" in findings["unit identity"]["what"]
    assert "pan -3090 to 3090, tilt -907 to 604" in findings["unit bounds"]["what"]
    assert findings["unit power"]["level"] == "ok"
    assert "firmware" in findings["board B-1 identity"]["what"]
    assert (
        "samples per second" in findings["board B-1 rate"]["what"]
    )  # a warning on a busy computer
    assert findings["tonight fits"]["level"] == "ok"


def test_a_unit_that_is_not_as_configured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = replace(E46, dialect="d46", homed=False, command_time_ms=5.0)
    with served(settings, BOARD):
        config = rig_yaml(tmp_path, PATHS["ptu"], "emulated", more=", dialect: e46")
        code, findings = doctor(config, capsys)
    assert code == 1
    assert findings["unit wrong_dialect"]["remedy"] == "set ptu.dialect in the rig file to auto"
    assert findings["unit not_homed"]["level"] == "warning"
    assert findings["board B-1 emulated"]["level"] == "note"


def test_devices_that_are_not_the_rig_s_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with served(E46, BOARD):
        config = rig_yaml(tmp_path, PATHS["ptu"], PATHS["board:B-1"], more=", serial: E46-0002")
        config.write_text(config.read_text().replace("460800}", "460800, facts: {uid: other}}"))
        code, findings = doctor(config, capsys)
    assert code == 1
    assert "E46-0001" in findings["unit wrong_unit"]["what"]
    assert "other" in findings["board B-1 wrong_board"]["what"]


def test_a_unit_at_another_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def answer(sent: bytes, speed: int) -> bytes:
        if speed != termios.B9600:
            return b"\xff" * len(sent)
        known = {b"V": b"* Pan-Tilt v1.90.0(D46 C14/E)", b"PN": b"* -10", b"PX": b"* 10"}
        words = (known.get(word, b"! Illegal Command Entered") for word in sent.split())
        return b"".join(word + b"\r\n" for word in words)

    with device(answer) as port:
        code, findings = doctor(rig_yaml(tmp_path, port, "emulated"), capsys)
    assert code == 1
    assert findings["unit wrong_baud"]["remedy"] == "set ptu.baud in the rig file to 9600"
    assert "the dialect d46" in findings["unit identity"]["what"]
    assert "tilt" in findings["unit no_bounds"]["what"]


def test_cables_that_are_swapped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with served(E46, BOARD):
        config = rig_yaml(tmp_path, PATHS["board:B-1"], PATHS["ptu"])
        code, findings = doctor(config, capsys)
    assert code == 1
    assert findings["unit wrong_device"]["level"] == "fault"
    assert {"board B-1 silent", "board B-1 text", "board B-1 garbage"} & set(findings)


def test_nothing_on_either_port(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(board_module, "FIRST_BYTE_TIMEOUT_S", 0.5)  # nothing will come
    with device(lambda *_: b"") as unit, device(lambda *_: b"") as silent:
        _, findings = doctor(rig_yaml(tmp_path, unit, silent), capsys)
    assert findings["unit silent"]["level"] == findings["board B-1 silent"]["level"] == "fault"
    with device(lambda sent, _: sent) as unit:
        _, findings = doctor(rig_yaml(tmp_path, unit, "emulated"), capsys)
    assert "is homing after power-up" in findings["unit echo_only"]["remedy"]


def test_a_board_at_another_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sequence = iter(range(10**9))

    def answer(sent: bytes, speed: int) -> bytes:
        if speed != termios.B115200:
            return b"\x80\x7f\xf8"
        frame = Sample(0, next(sequence) & 0xFFFF, 0, (1, 2, 3)).encode()
        return frame + (HELLO.encode() if sent else b"")

    with device(answer) as port:
        _, findings = doctor(rig_yaml(tmp_path, "emulated", port), capsys)
    assert findings["board B-1 wrong_baud"]["remedy"] == (
        "set `baud` of the board to 115200 in the rig file"
    )


def test_a_board_that_loses_and_does_not_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    faults = BoardFaults(drop_frame_every=5, flip_bit_every=7)
    with served(E46, replace(BOARD, faults=faults)):
        _, findings = doctor(rig_yaml(tmp_path, "emulated", PATHS["board:B-1"]), capsys)
    assert "samples were missing" in findings["board B-1 damaged"]["what"]


def test_boards_that_speak_otherwise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = iter(range(10**9))
    with device(lambda *_: b"%d,1,2,3\r\n" % next(lines)) as port:
        _, findings = doctor(rig_yaml(tmp_path, "emulated", port), capsys)
        assert (
            "set `format: text` and `columns` of the board" in findings["board B-1 text"]["remedy"]
        )
        path = tmp_path / "text.yaml"
        path.write_text(
            f"rig: r\nptu: {{port: emulated}}\nboards:\n- {{id: T-1, port: {port}, format: text, "
            "columns: {time: 0, gyro: [1, 2, 3]}, "
            "facts: {uid: t, sensor: s, gyro_scale_rad_s: 0.001}}\n"
        )
        _, findings = doctor(path, capsys)
        assert "lines of numbers" in findings["board T-1 identity"]["what"]
    with device(lambda *_: Sample(0, next(lines) & 0xFFFF, 0, (1, 2, 3)).encode()) as port:
        _, findings = doctor(rig_yaml(tmp_path, "emulated", port), capsys)
        assert findings["board B-1 no_hello"]["level"] == "fault"


def test_a_held_port_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = bytearray()

    def listen(sent: bytes, _: int) -> bytes:
        heard.extend(sent)
        return b""

    with device(listen) as port:
        held = os.open(port, os.O_RDWR | os.O_NOCTTY)
        fcntl.flock(held, fcntl.LOCK_EX)
        code, findings = doctor(rig_yaml(tmp_path, port, "emulated"), capsys)
        os.close(held)
        assert {key for key in findings if key.startswith("unit ")} <= {"unit held", "unit in_use"}
        assert f"process {os.getpid()}" in str(findings)
        assert not heard
        code, findings = doctor(rig_yaml(tmp_path, port, "emulated"), capsys, "--no-open")
        assert code in (0, 1, 4)
        assert not heard


def test_as_a_person_reads_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = rig_yaml(tmp_path, "/dev/none", "/dev/none2")
    assert run(["doctor", "--config", str(config), "--out", str(tmp_path)]) == 1
    lines = capsys.readouterr().out.splitlines()
    at = lines.index("FAULT   unit: the port /dev/none does not exist")
    assert lines[at + 1].startswith("        -> Check")
    assert lines[-1].startswith("2 faults")
    assert run(["doctor", "--config", str(tmp_path / "none.yaml")]) == UsageError.exit_code


def test_it_runs_where_numpy_does_not_start(tmp_path: Path) -> None:
    """A processor too old for NumPy's wheels is what it has to tell of."""
    config = rig_yaml(tmp_path, "emulated", "emulated")
    script = (
        "import sys; sys.modules['numpy'] = None\n"
        "from gyrorig_daemon.cli import run; sys.exit(run(sys.argv[1:]))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script, "doctor", "--config", str(config), "--out", str(tmp_path),
         "--socket", str(tmp_path / "sock"), "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode in (0, 1, 4), ended.stderr
    assert json.loads(ended.stdout)["findings"]
