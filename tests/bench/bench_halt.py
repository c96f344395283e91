"""How long it takes until the unit is told to halt, for each way in which something can go wrong.

Each trial starts a service on emulated devices, sets the unit in motion, disturbs the service and
measures the time until the halt command arrives at the unit. Trials are appended to a file, so
that a run that was interrupted goes on where it ended. Several runs can share the file.

    --trials N   of each case
    --case NAME  only this case; can be repeated
    --out FILE   the trials, one JSON object per line
    --table      only print the table of the file

Bar: docs/halting.md. Run: python tests/bench/bench_halt.py [--trials 50] [--out FILE]
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.support.halt_trials import (
    XOFF,
    connections_of_another_user,
    flooding_board,
    hanging_disk,
    make_unit_say,
    prepare_hang,
    set_in_motion,
    terminal,
)
from tests.support.served_rig import Devices, Service, wait_for

from gyrorig_daemon.emulator.pty_server import raw_now_ns
from gyrorig_daemon.service.service_client import send_command

PATIENCE_S = 20.0
NOBODY = 65534
QUEUE_FILES = 20_000

Trial = Callable[[Service, Devices], float]


def echo(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def stop_motion(service: Service) -> None:
    """Order a halt as a person does."""
    send_command(service.socket, "halt")


def terminate(service: Service) -> None:
    """Order the end as systemd does."""
    assert service.process is not None
    service.process.send_signal(signal.SIGTERM)


def send_to_daemon(number: signal.Signals) -> Callable[[Service], None]:
    """Return what sends a signal to the daemon."""

    def send(service: Service) -> None:
        assert service.process is not None
        os.kill(service.process.pid, number)

    return send


def send_to_acquisition(number: signal.Signals) -> Callable[[Service], None]:
    """Return what sends a signal to the acquisition process."""

    def send(service: Service) -> None:
        (child,) = service.children()
        os.kill(child, number)

    return send


def measure(service: Service, devices: Devices, disturb: Callable[[Service], None]) -> float:
    """Disturb a service whose unit moves; return the seconds until the halt."""
    begin_ns = raw_now_ns()
    disturb(service)
    return devices.halt_after_s(begin_ns, PATIENCE_S)


def plain(disturb: Callable[[Service], None]) -> Trial:
    """Return a trial on a service to which nothing else happens."""

    def run(service: Service, devices: Devices) -> float:
        service.start_ready(subprocess.DEVNULL)
        set_in_motion(service, devices)
        return measure(service, devices, disturb)

    return run


def on_stopped_terminal(disturb: Callable[[Service], None]) -> Trial:
    """Return a trial in a terminal after Ctrl-S."""

    def run(service: Service, devices: Devices) -> float:
        with terminal() as (screen, line):
            service.start_ready(line)
            set_in_motion(service, devices)
            os.write(screen, XOFF)
            try:
                return measure(service, devices, disturb)
            finally:
                service.close()

    return run


def on_hanging_disk(disturb: Callable[[Service], None] | None) -> Trial:
    """Return a trial while the main loop hangs; without an order, from the hang on."""

    def run(service: Service, devices: Devices) -> float:
        prepare_hang(service)
        service.start_ready(subprocess.DEVNULL)
        set_in_motion(service, devices)
        begin_ns = raw_now_ns()
        with hanging_disk(service):
            if disturb is None:
                return devices.halt_after_s(begin_ns, PATIENCE_S)
            return measure(service, devices, disturb)

    return run


def with_flood(disturb: Callable[[Service], None]) -> Trial:
    """Return a trial while a board sends as fast as its line takes."""

    def run(service: Service, devices: Devices) -> float:
        with flooding_board(service):
            service.start_ready(subprocess.DEVNULL)
            set_in_motion(service, devices)
            wait_for(lambda: service.status()["acquisition_dropped_bytes"] > 0)
            return measure(service, devices, disturb)

    return run


def with_many_clients(service: Service, devices: Devices) -> float:
    """Order a halt as root while another user opens all connections that it can."""
    service.start_ready(subprocess.DEVNULL)
    set_in_motion(service, devices)
    service.folder.chmod(0o755)
    service.socket.chmod(0o666)
    with connections_of_another_user(NOBODY, service.socket):
        return measure(service, devices, stop_motion)


def with_full_queue(service: Service, devices: Devices) -> float:
    """Order a halt while the queue holds very many files."""
    service.start_ready(subprocess.DEVNULL)
    set_in_motion(service, devices)
    for number in range(QUEUE_FILES):
        path = service.state / "queue" / f"x{number:06}.yaml"
        os.close(os.open(path, os.O_CREAT | os.O_WRONLY))
    return measure(service, devices, stop_motion)


def with_unit_that_says(answer: Callable[[bytes], bytes]) -> Trial:
    """Return a trial whose unit says something else from a moment on."""

    def run(service: Service, devices: Devices) -> float:
        service.start_ready(subprocess.DEVNULL)
        set_in_motion(service, devices)
        begin_ns = raw_now_ns()
        make_unit_say(devices, answer)
        return devices.halt_after_s(begin_ns, PATIENCE_S)

    return run


CASES: dict[str, tuple[float, Trial]] = {
    "ordered: stop-motion": (0.5, plain(stop_motion)),
    "ordered: SIGTERM": (0.5, plain(terminate)),
    "dying: SIGKILL of the daemon": (0.5, plain(send_to_daemon(signal.SIGKILL))),
    "dying: SIGKILL of the acquisition process": (0.5, plain(send_to_acquisition(signal.SIGKILL))),
    "hanging: SIGSTOP of the daemon": (4.0, plain(send_to_daemon(signal.SIGSTOP))),
    "hanging: SIGSTOP of the acquisition process": (
        6.0,
        plain(send_to_acquisition(signal.SIGSTOP)),
    ),
    "hanging: disk, no order": (5.0, on_hanging_disk(None)),
    "hanging: disk, stop-motion": (0.5, on_hanging_disk(stop_motion)),
    "hanging: disk, SIGTERM": (0.5, on_hanging_disk(terminate)),
    "flooding: board, stop-motion": (0.5, with_flood(stop_motion)),
    "flooding: board, SIGTERM": (0.5, with_flood(terminate)),
    "flooding: clients, stop-motion": (0.5, with_many_clients),
    "flooding: queue, stop-motion": (0.5, with_full_queue),
    "blocking: terminal, stop-motion": (0.5, on_stopped_terminal(stop_motion)),
    "blocking: terminal, SIGTERM": (0.5, on_stopped_terminal(terminate)),
    "lying: mute unit": (10.0, with_unit_that_says(lambda _: b"")),
    "lying: noise for answers": (10.0, with_unit_that_says(lambda data: b"\xa5" * len(data))),
}


@contextmanager
def rig() -> Iterator[tuple[Service, Devices]]:
    """Yield a service that is not started, and its devices."""
    devices = Devices()
    folder = Path(tempfile.mkdtemp(prefix="halt"))  # a socket's path must be short
    service = Service(folder, devices)
    try:
        yield service, devices
    finally:
        service.close()
        devices.close()
        shutil.rmtree(folder, ignore_errors=True)


def read_trials(path: Path) -> dict[str, list[float]]:
    """Return the seconds of all trials in the file, by case."""
    trials: dict[str, list[float]] = defaultdict(list)
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            trials[row["case"]].append(row["s"])
    return trials


def print_table(trials: dict[str, list[float]]) -> bool:
    """Print the maxima; return whether all are within their bounds."""
    echo(f"{'case':46} {'bound s':>8} {'max s':>8} {'median s':>9} {'trials':>7}")
    for case, (bound_s, _) in CASES.items():
        times = sorted(trials.get(case, []))
        if times:
            echo(
                f"{case:46} {bound_s:8.1f} {times[-1]:8.3f} {times[len(times) // 2]:9.3f} "
                f"{len(times):7}"
            )
    return all(max(trials[case], default=0.0) <= CASES[case][0] for case in trials)


def main() -> int:
    """Run the trials that are missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--case", action="append", choices=sorted(CASES))
    parser.add_argument("--out", type=Path, default=Path("bench-halt.jsonl"))
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    cases = options.case or list(CASES)
    for number in range(0 if options.table else options.trials):
        for case in cases:
            if len(read_trials(options.out)[case]) > number:
                continue
            begin_s = time.monotonic()
            with rig() as (service, devices):
                seconds = CASES[case][1](service, devices)
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"case": case, "s": round(seconds, 4)}) + "\n")
            echo(f"{case}: {seconds:.3f} s ({time.monotonic() - begin_s:.0f} s)")
    return 0 if print_table(read_trials(options.out)) else 1


if __name__ == "__main__":
    sys.exit(main())
