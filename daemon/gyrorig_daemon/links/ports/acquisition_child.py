"""Start and end of the acquisition process, without an unlimited wait.

What to use when: `start_child` once per `AcquisitionHub`; `kill_child` for a process that does not
respond; `close_child` for each process in the end. A process that waits for a driver of the
system, such as that of an unplugged USB adapter, ends only when the driver returns, even if it is
killed. It keeps its ports until then.
"""

import json
import subprocess
from collections.abc import Mapping, Sequence
from typing import Any

from gyrorig_protocol.child_process import module_command
from gyrorig_protocol.errors import MachineError

CLOSE_DEADLINE_S = 2.0
KILL_DEADLINE_S = 1.0  # a killed process ends within milliseconds, if no driver hangs
HANGS = "it does not end, because a driver of the system does not return"


def start_child(
    arguments: Mapping[str, Any], passed_fds: Sequence[int]
) -> tuple[subprocess.Popen[bytes], int, int]:
    """Start the acquisition process.

    Args:
        arguments: its settings; see `acquisition.main`.
        passed_fds: file descriptors that it inherits.

    Returns:
        The process, the descriptor to which commands are written, and the one of its reports.

    Raises:
        MachineError: it cannot be started.
    """
    try:
        child = subprocess.Popen(  # noqa: S603 - our own module, our own interpreter
            module_command("gyrorig_daemon.links.ports.acquisition", json.dumps(arguments)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,  # Ctrl-C must reach the daemon only
            pass_fds=passed_fds,
        )
    except OSError as fault:
        raise MachineError(
            f"the acquisition process cannot be started ({fault.strerror})",
            "free memory or end other processes, and start the program again",
        ) from fault
    if child.stdin is None or child.stdout is None:
        raise MachineError(
            "the operating system created no pipes to the acquisition process",
            "start the program again",
        )
    return child, child.stdin.fileno(), child.stdout.fileno()


def await_end(child: "subprocess.Popen[bytes]", deadline_s: float) -> bool:
    """Wait for the end of a process; return whether it has ended within `deadline_s`."""
    try:
        child.wait(deadline_s)
    except subprocess.TimeoutExpired:
        return False
    return True


def kill_child(child: "subprocess.Popen[bytes]") -> bool:
    """Kill a process; return whether it has ended within `KILL_DEADLINE_S`."""
    child.kill()
    return await_end(child, KILL_DEADLINE_S)


def close_child(child: "subprocess.Popen[bytes]") -> str:
    """Close the pipes to a process and end it; return why it could not be ended, "" if it ended."""
    if child.stdin is not None:
        child.stdin.close()
    has_ended = await_end(child, CLOSE_DEADLINE_S) or kill_child(child)
    if child.stdout is not None:
        child.stdout.close()
    if has_ended:
        return ""
    return (
        f"The acquisition process ({child.pid}) still has the ports: {HANGS}. Unplug the USB "
        "adapters of the rig and plug them in again. If that does not help, restart the computer."
    )
