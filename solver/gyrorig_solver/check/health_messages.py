"""Messages about the health of a recording: a verdict, and problems with remedies.

What to use when: `health_verdict` for the first line, `health_problems` for the lines below.
Every problem has the form "What is wrong. What to do."
"""

from collections.abc import Iterator

from gyrorig_protocol.errors import sentence
from gyrorig_protocol.recording.mcap.losses import LossCause
from gyrorig_solver.calibration.calibration_wording import collapse_groups
from gyrorig_solver.check.recording_health import BoardHealth, RecordingHealth
from gyrorig_solver.data.link_remedies import CLOCK_STEP, LOST_SAMPLES, REPEATS, RESTART
from gyrorig_solver.data.stream.stuck_axes import CLIPPING_REMEDY

MAX_LOST_SHARE = 0.02  # above this share a calibration is limited

_COPY_REMEDY = (
    "Copy the file again from its source if it is complete there, or use the data that can be read."
)
_LOSS_REMEDIES = {
    LossCause.UNFINISHED: (
        "Run `gyrorigd recover FOLDER` on the rig to finish the file. No data on the disk are lost."
    ),
    LossCause.TRUNCATED: _COPY_REMEDY,
    LossCause.DAMAGED: _COPY_REMEDY,
    LossCause.REFUSED: "The file was not written by gyrorigd, or its bytes were changed. "
    + _COPY_REMEDY,
    LossCause.MESSAGE: "The other messages are used. Record again if samples are missing.",
    LossCause.SUMMARY: "No action is needed, because the file can be read without its summary.",
    LossCause.METADATA: (
        "No action is needed now, but check the disk on which the file was written."
    ),
    LossCause.MISSING: _COPY_REMEDY,
}
_FAULT_REMEDY = (
    "Run `gyrorigd doctor --config RIG.yaml` to check whether the fault is still present."
)


def health_verdict(health: RecordingHealth) -> str:
    """Return the verdict on a recording, in a few words."""
    broken = [board.board for board in health.boards if board.fault]
    if len(broken) == len(health.boards):
        return "not usable"
    if broken:
        return f"usable in part, without {', '.join(broken)}"
    remarks = any(_quality_messages(health)) or not health.complete
    if health.identifiable:
        return "usable, with remarks" if remarks else "sound"
    first = "usable, with remarks" if remarks else "sound"
    return f"{first}, but cannot calibrate all"


def health_problems(health: RecordingHealth) -> tuple[str, ...]:
    """Return the problems of a recording, each with its remedy; empty if it is sound."""
    return (*_quality_messages(health), *_capability_messages(health))


def _quality_messages(health: RecordingHealth) -> Iterator[str]:
    yield from (f"{loss.text}. {_LOSS_REMEDIES[loss.cause]}" for loss in health.losses)
    for topic, count in health.dropped.items():
        yield (
            f"the daemon dropped {count} messages of {topic}, because its disk was full or too "
            "slow. Free space on that disk."
        )
    yield from (
        f"the daemon noted a fault during the recording, {text}. {_FAULT_REMEDY}"
        for text in health.faults
    )
    if not health.boards:
        yield (
            "the recording contains no samples of a board. Connect a board, and check with "
            "`gyrorigd doctor --config RIG.yaml` that it answers."
        )
    for board in health.boards:
        yield from _board_messages(board)
    if health.unit is not None and health.unit.unsynchronised:
        yield (
            f"{health.unit.unsynchronised} positions of the unit were read while its "
            "position was unknown, and are not used. Check the cable of the unit."
        )


def _board_messages(board: BoardHealth) -> Iterator[str]:
    name = board.board
    if board.fault:
        yield f"{name} cannot be used, because {board.fault}"
        return
    if board.lost > MAX_LOST_SHARE * (board.samples + board.lost):
        yield f"{name} lost {board.lost} samples. {sentence(LOST_SAMPLES.for_link(board.link))}"
    yield from (
        f"of {name}, {finding.seen_as}. {sentence(finding.remedy)}" for finding in board.still_axes
    )
    if board.attitudes is not None and board.attitudes.mirror:
        yield f"of {name}, {board.attitudes.mirror}"
    # A saturated sample has the same remedy as the clipped axis that contains it.
    if board.saturated > 0 and all(axis.remedy != CLIPPING_REMEDY for axis in board.still_axes):
        yield f"{name} has {board.saturated} saturated samples. {sentence(CLIPPING_REMEDY)}"
    if board.repeated > MAX_LOST_SHARE * board.samples:
        yield f"{name} repeats {board.repeated} samples. {sentence(REPEATS.for_link(board.link))}"
    if board.restarts:
        yield f"{name} restarted {board.restarts} times. {sentence(RESTART.for_link(board.link))}"
    if board.clock_steps:
        yield (
            f"the clock of {name} or of the host jumped {board.clock_steps} times. "
            f"{sentence(CLOCK_STEP.for_link(board.link))}"
        )


def _capability_messages(health: RecordingHealth) -> Iterator[str]:
    """Yield the parameters that the motion does not make observable."""
    for board in health.boards:
        if board.fault:
            continue
        if board.observability is None:
            yield f"{board.board} cannot be calibrated alone, because {board.no_reference}"
        elif board.observability.unobservable:
            unobservable = ", ".join(collapse_groups(board.observability.unobservable))
            reasons = "; ".join(board.observability.reasons) or "Turn the board about every axis"
            yield f"{unobservable} of {board.board} cannot be determined. {sentence(reasons)}"
