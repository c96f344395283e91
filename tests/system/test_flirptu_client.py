"""Unmodified clients from the package index drive the emulated unit on its pty.

`flirptu` 0.0.1a2 was written for a real unit: it wants verbose replies at the start, reads
fixed columns, and has faults of its own that show on any unit (its mode is always `vel`, its
query of the present speed cannot be read). `flir-ptu` 0.1.0 was written for a unit's network
port: it waits for that port's greeting, ends its commands with LF, and cannot tell an angle.
Their faults are asserted here as they are: an emulated unit that "repaired" them would not
answer like a real one.
"""

import gc
import importlib
import os
import select
import socket
import threading
import tty
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, PtuSettings, RigSettings
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns

PTU: Any = importlib.import_module("flirptu").PTU  # it has no types
GREETING = b"\r\n### PAN-TILT CONTROLLER\r\n*"  # of a network port


@contextmanager
def served(settings: PtuSettings) -> Iterator[str]:
    """Yield the path of an emulated unit that runs in real time, a board beside it."""
    rig = EmulatedRig(RigSettings(seed=1, ptu=settings, boards=(BoardSettings(),)), raw_now_ns())
    server = PtyServer(rig)
    stop = threading.Event()
    thread = threading.Thread(target=server.run, args=(stop.is_set,))
    thread.start()
    try:
        yield server.paths["ptu"]
    finally:
        stop.set()
        thread.join()
        server.close()


@contextmanager
def bridged(path: str) -> Iterator[int]:
    """Yield a port of the loopback interface that is a unit's: bytes pass as they are."""
    line = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(line)
    ended, listener = os.pipe(), socket.create_server(("127.0.0.1", 0))
    listener.settimeout(60.0)

    def serve() -> None:
        with listener.accept()[0] as client:
            client.sendall(GREETING)
            watched: list[Any] = [client, line, ended[0]]
            while True:
                ready = select.select(watched, [], [])[0]
                if ended[0] in ready or (client in ready and not (data := client.recv(4096))):
                    return
                if client in ready:
                    os.write(line, data)
                if line in ready:
                    client.sendall(os.read(line, 4096))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        os.write(ended[1], b"x")
        thread.join()
        listener.close()
        for handle in (line, *ended):
            os.close(handle)


@pytest.mark.parametrize("command_time_ms", [1.0, 20.0])
@pytest.mark.parametrize(("echo", "baud"), [(True, 9600), (False, 9600), (True, 115200)])
def test_a_whole_script(echo: bool, baud: int, command_time_ms: float) -> None:
    with served(PtuSettings(echo=echo, command_time_ms=command_time_ms)) as path:
        unit = PTU(path, baud=baud, timeout=60)
        assert unit.echo is echo
        assert unit.panResolution == unit.tiltResolution == 185.142857
        assert (unit.minPan, unit.maxPan) == (-3090, 3090)
        assert (unit.minTilt, unit.maxTilt) == (-907, 604)
        assert (unit.maxPanSpeed, unit.maxTiltSpeed) == (2902, 2902)
        assert unit.controlMode == "vel"  # the client's fault: it looks at the wrong word

        assert unit.getPosition() == (0, 0)
        assert unit.setSpeed(2000, 1500)
        assert unit.getTargetSpeed() == (2000, 1500)
        assert unit.setPosition(400, -300, blocking=True)
        assert unit.getPosition() == (400, -300)
        assert unit.setPositionAndSpeed(200, 100, 1000, 900, blocking=True)
        assert unit.getPosition() == (200, 100)
        assert unit.setPositionOffset(-50, 25, blocking=True)
        assert unit.getPosition() == (150, 125)
        assert unit.setSpeedOffset(600, 500)
        assert unit.getTargetSpeed() == (600, 500)

        with pytest.warns(RuntimeWarning, match="Maximum allowable Pan position is 3090"):
            assert not unit.setPanPosition(4000)
        with pytest.warns(RuntimeWarning, match="Minimum allowable Tilt position is -907"):
            assert not unit.setTiltPosition(-2000)
        with pytest.warns(RuntimeWarning, match="Pan speed cannot exceed 2902"):
            assert not unit.setPanSpeed(5000)
        assert unit.getPosition() == (150, 125)
        assert unit.getTargetSpeed() == (600, 500)

        assert unit.setPanPosition(unit.panAngleToPosition(-60.0))
        assert unit.getTargetPanPosition() == -1167
        first = unit.getPanPosition()
        second = unit.getPanPosition()
        assert -1167 < second < first <= 150
        assert unit.halt()
        unit.send(b"A ")
        stopped = unit.getPanPosition()
        assert unit.getTargetPanPosition() == stopped

        with pytest.raises(ValueError, match="ositions/sec"):
            unit.getPanSpeed()  # the client's fault: it forgets the unit in the text
        unit.echo = not echo
        assert unit.getPosition() == (stopped, 125)
        assert unit.send("VM ") == "* PTU-E46-17.5"
        del unit  # halts and closes; the unit must still be there


def test_terse_at_the_start_is_more_than_the_client_can_read() -> None:
    with served(PtuSettings(verbose=False)) as path:
        with pytest.raises(ValueError, match="invalid literal") as fault:
            PTU(path, timeout=10)
        # What is left of the client halts the unit as it goes: let it, while there is one.
        del fault
        gc.collect()


@pytest.fixture(scope="module")
def network_client() -> Any:
    """The client that speaks Telnet, by a module that Python 3.13 has no more."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        pytest.importorskip("telnetlib", reason="flir-ptu needs telnetlib: gone since Python 3.13")
        return importlib.import_module("flir_ptu.ptu").PTU


@pytest.mark.parametrize("command_time_ms", [1.0, 20.0])
@pytest.mark.parametrize("echo", [True, False])
def test_a_script_over_the_network(network_client: Any, echo: bool, command_time_ms: float) -> None:
    settings = PtuSettings(echo=echo, command_time_ms=command_time_ms)
    with served(settings) as path, bridged(path) as port:
        unit = network_client("127.0.0.1", port)
        unit.connect()
        assert unit.stream.is_connected
        assert (unit.pan(), unit.tilt()) == ("0", "0")
        unit.pan(400)  # polls until it is there
        unit.tilt(-300)
        assert (unit.pan(), unit.tilt()) == ("400", "-300")
        assert (unit.pan_offset(), unit.tilt_offset()) == ("400", "-300")  # the targets
        unit.pan_angle(5.0)
        assert unit.pan() == "195"  # of the D48's 92.5714", which it takes every unit to have
        with pytest.raises(TypeError):
            unit.pan_angle()  # the client's fault: it multiplies a text
        unit.stream.send("pp9999")  # by `pan` it would wait for a `*` for ever
        if echo:
            assert unit.stream.read_until("\n") == b"pp9999\n"
        refused = b"! Maximum allowable Pan position is 3090\r\n"
        assert unit.stream.read_until("\n") == refused
        assert unit.pan() == "195"
        unit.stream.close()
