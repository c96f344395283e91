"""An unmodified client from the package index drives the emulated unit on its pty.

`flirptu` 0.0.1a2 was written for a real unit: it wants verbose replies at the start, reads
fixed columns, and has faults of its own that show on any unit (its mode is always `vel`, its
query of the present speed cannot be read). They are asserted here as they are: an emulated
unit that "repaired" them would not answer like a real one.
"""

import gc
import importlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns
from gyrorig_daemon.emulator.rig import EmulatedRig
from gyrorig_daemon.emulator.settings import BoardSettings, PtuSettings, RigSettings

PTU: Any = importlib.import_module("flirptu").PTU  # it has no types


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


@pytest.mark.parametrize("command_time_ms", [1.0, 20.0])
@pytest.mark.parametrize(("echo", "baud"), [(True, 9600), (False, 9600), (True, 115200)])
def test_a_whole_script(echo: bool, baud: int, command_time_ms: float) -> None:
    with served(PtuSettings(echo=echo, command_time_ms=command_time_ms)) as path:
        unit = PTU(path, baud=baud, timeout=10)
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
