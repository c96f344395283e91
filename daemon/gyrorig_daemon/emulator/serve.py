"""The emulated rig as a process: open, tell where, run until stopped.

What to use when: `serve` from a command line, with `stop_on_signals()` for its `stop`;
`PtyServer` itself where the caller wants the loop in its own hands.
"""

import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FrameType

from gyrorig_daemon.emulator.pty_server import PtyServer
from gyrorig_daemon.emulator.rig import EmulatedRig


def serve(
    rig: EmulatedRig,
    announce: Callable[[Mapping[str, str]], None],
    stop: Callable[[], bool],
    links: Path | None = None,
) -> None:
    """Run the rig's devices on ptys in real time until `stop` returns True.

    Args:
        rig: powered up at a time of CLOCK_MONOTONIC_RAW.
        announce: called once with the path of each port, when all can be opened.
        stop: asked at least 50 times a second.
        links: a folder for symbolic links of the ports' names.

    Raises:
        MachineError: no pty can be opened.
    """
    server = PtyServer(rig, links)
    try:
        announce(server.paths)
        server.run(stop)
    finally:
        server.close()


def stop_on_signals() -> Callable[[], bool]:
    """Take SIGTERM and SIGINT as the wish to stop; return whether one has come."""
    stopped = False

    def note(_signal: int, _frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True

    for wanted in (signal.SIGTERM, signal.SIGINT):
        signal.signal(wanted, note)
    return lambda: stopped
