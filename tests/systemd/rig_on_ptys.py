"""An emulated rig on ptys outside of the service manager, whose log of orders can be read.

What to use when: a unit that outlives every daemon that talks to it, as a real one does.
"""

import threading
from pathlib import Path
from types import TracebackType

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, PtuSettings, RigSettings
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns

FAR = "name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 4.0}\n"  # 37.5 s


class RigOnPtys:
    """A unit and a board, served in a thread; a context."""

    def __init__(self) -> None:
        """Open the ptys."""
        ptu = PtuSettings(baud=115200, command_time_ms=2.0)
        board = BoardSettings(name="B-1", odr_hz=100.0)
        self.rig = EmulatedRig(RigSettings(seed=1, ptu=ptu, boards=(board,)), raw_now_ns())
        self._server = PtyServer(self.rig)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._server.run, args=(self._ended.is_set,))

    def write_config(self, folder: Path) -> Path:
        """Write the rig's configuration and return its path."""
        path = folder / "rig.yaml"
        paths = self._server.paths
        path.write_text(
            f"rig: l1\nptu: {{port: {paths['ptu']}, baud: 115200}}\n"
            f"boards: [{{id: B-1, port: {paths['board:B-1']}, baud: 460800}}]\n"
        )
        return path

    @property
    def ports(self) -> list[str]:
        """The ptys' paths."""
        return list(self._server.paths.values())

    @property
    def turns(self) -> bool:
        """True while an axis moves."""
        now_s = (raw_now_ns() - self.rig.origin_ns) * 1e-9
        stage = self.rig.stage
        return stage.pan.is_moving(now_s) or stage.tilt.is_moving(now_s)

    @property
    def halts(self) -> int:
        """How often it was told to halt."""
        return [order[0] for order in self.rig.stage.pan.commands].count("halt")

    def order(self, text: bytes) -> None:
        """Put it in motion, as somebody did who is gone now."""
        if self.rig.ptu is None:
            raise AssertionError
        self.rig.ptu.receive(text, raw_now_ns())

    def __enter__(self) -> "RigOnPtys":
        """Serve."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End."""
        self._ended.set()
        self._thread.join()
        self._server.close()
