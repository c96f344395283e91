"""The check of a twin's folder: runs all simulations for each recording and board.

What to use when: `check_twin_folder`. The default simulation is the twin's rig file without its
section `twin`: the same devices on the same ports, with the properties of the shipped emulator.
The twin without its causes separates the gain of the calibration from the gain of the causes.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.documents import dump_yaml, parse_yaml
from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.twin import Twin, parse_twin
from gyrorig_solver.pipeline import check_given_once
from gyrorig_solver.twin_check.observed_session import check_has_unit
from gyrorig_solver.twin_check.recording_check import BoardCheck, check_board
from gyrorig_solver.twin_check.simulation import Simulator, run_draws

TWIN_FILE = "twin.yaml"
MIN_OTHER_DRAWS = 5
MIN_DRAWS, DEFAULT_DRAWS = 10, 20  # fewer draws have too little power to list causes
SHARE_OF_OTHERS = 4  # the other simulations only need a density, so they have fewer draws


@dataclass(frozen=True, slots=True, eq=False)
class TwinCheck:
    """The check of all recordings."""

    twin: Twin
    draws: int
    boards: tuple[BoardCheck, ...]
    # recording, board and error; without a board: the whole recording
    failed: tuple[tuple[str, str | None, GyrorigError], ...]

    @property
    def held_out(self) -> tuple[BoardCheck, ...]:
        """The results of recordings that the twin was not fitted to."""
        return tuple(check for check in self.boards if check.is_held_out)


def check_twin_folder(
    folder: Path,
    recordings: Sequence[Recording],
    draws: int = DEFAULT_DRAWS,
    board: str | None = None,
    on_run: Callable[[int, int], None] = lambda _finished, _total: None,
) -> TwinCheck:
    """Compare measured recordings with the default simulation and with a twin.

    Args:
        folder: of the twin, with `twin.yaml`.
        recordings: measured.
        draws: of the twin's posterior.
        board: only this board; None: all boards of the twin.
        on_run: called after each simulated session with the number of finished ones and of all.

    Raises:
        UsageError: the folder has no valid twin, a recording is given twice, or the daemon is not
            installed.
        GyrorigError: nothing can be checked.
    """
    check_given_once(recordings)
    path = folder / TWIN_FILE
    text = _read_twin(path)
    twin = parse_twin(text, str(path))
    fitted = {entry.sha256 for entry in twin.recordings}
    checks: list[BoardCheck] = []
    failed: list[tuple[str, str | None, GyrorigError]] = []
    other_draws = max(MIN_OTHER_DRAWS, draws // SHARE_OF_OTHERS)
    others = range(other_draws + 1)
    # If the twin has no causes, the twin without its causes is the same, and is not simulated.
    draws_by_simulator = [others, others if twin.causes else range(0), range(draws + 1)]
    total = len(recordings) * sum(map(len, draws_by_simulator))
    finished = 0

    def count_run() -> None:
        nonlocal finished
        finished += 1
        on_run(finished, total)

    with tempfile.TemporaryDirectory(prefix="gyrorig-twin-check-") as scratch_name:
        scratch = Path(scratch_name)
        default_path = scratch / "default.yaml"
        default_path.write_text(default_rig_text(text, path), encoding="utf-8")
        calibrated_path = scratch / "without-causes.yaml"
        calibrated_path.write_text(calibrated_rig_text(text, path), encoding="utf-8")
        simulators = [
            Simulator("before", default_path, is_twin=False),
            Simulator("without-causes", calibrated_path),
            Simulator("after", path),
        ]
        for number, recording in enumerate(recordings):
            try:
                check_has_unit(recording)
                boards = _boards(twin, recording, board)
                runs = run_draws(
                    list(zip(simulators, draws_by_simulator, strict=True)),
                    recording,
                    scratch / str(number),
                    count_run,
                )
            except GyrorigError as fault:
                failed.append((recording.path.name, None, fault))
                continue
            for name in boards:
                try:
                    checks.append(
                        check_board(recording, name, recording.sha256 not in fitted, *runs)
                    )
                except GyrorigError as fault:
                    failed.append((recording.path.name, name, fault))
    if failed and not checks:
        raise failed[0][2]
    return TwinCheck(twin, draws, tuple(checks), tuple(failed))


def _read_twin(path: Path) -> bytes:
    if path.parent.is_file():
        raise UsageError(
            f"{path.parent} is a file, and a check needs the folder of a twin",
            f"give the folder {path.parent.parent}",
        )
    try:
        return path.read_bytes()
    except OSError as fault:
        raise UsageError(
            f"the twin {path} cannot be read ({fault.strerror})",
            "give the folder that `gyrorig twin` wrote",
        ) from fault


def default_rig_text(text: bytes, path: Path) -> str:
    """Return the rig file of the default simulation of the same devices."""
    document = parse_yaml(text, str(path), UsageError)
    return dump_yaml({key: value for key, value in document.items() if key != "twin"})


def calibrated_rig_text(text: bytes, path: Path) -> str:
    """Return the rig file of the twin without its causes and their uncertainty."""
    document = parse_yaml(text, str(path), UsageError)
    section = {**document["twin"], "causes": []}
    posterior = section.pop("posterior", None)
    if posterior is not None:
        fitted_rows = [row for row, name in enumerate(posterior["names"]) if not _is_of_cause(name)]
        if fitted_rows:
            rows = [posterior["covariance"][row] for row in fitted_rows]
            section["posterior"] = {
                **posterior,
                "names": [posterior["names"][row] for row in fitted_rows],
                "covariance": [[row[column] for column in fitted_rows] for row in rows],
            }
    return dump_yaml({**document, "twin": section})


def _is_of_cause(name: str) -> bool:
    """Return whether a name of the posterior is that of a value of a cause."""
    return name.startswith("causes.")


def _boards(twin: Twin, recording: Recording, board: str | None) -> list[str]:
    """Return the boards that twin and recording both have.

    Raises:
        UsageError: there are none.
    """
    boards: list[str] = [
        name for name in recording.board_ids if name in twin.boards and board in (None, name)
    ]
    if not boards:
        raise UsageError(
            f"the twin has none of the requested boards of {recording.path.name}",
            f"its boards are {', '.join(twin.boards)}",
        )
    return boards
