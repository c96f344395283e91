"""What the daemon counts of itself, from its start on."""

from dataclasses import dataclass


@dataclass(slots=True)
class ServiceCounts:
    """Each only grows; what it means is in docs/service.md."""

    sessions_done: int = 0
    sessions_failed: int = 0
    sessions_stopped: int = 0
    sessions_put_off: int = 0
    motion_faults: int = 0
    unit_lost: int = 0
    unit_reopened: int = 0
    reloads: int = 0
    reloads_refused: int = 0
    acquisition_restarts: int = 0
    emulator_restarts: int = 0
    clock_steps: int = 0
    late_turns: int = 0
    clients: int = 0
    clients_slow: int = 0
    clients_refused: int = 0
    requests: int = 0
    requests_refused: int = 0
