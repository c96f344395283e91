"""The emulated rig as a process: open, tell where, run until stopped.

What to use when: `serve` from a command line; `PtyServer` itself where the caller wants
the loop in its own hands.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

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
