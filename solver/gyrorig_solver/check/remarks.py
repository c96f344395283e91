"""A recording's health in words: one verdict, and what is wrong with what to do about it.

What to use when: `verdict` for the sentence at the head, `problems` for the lines below it.
Every problem is `what is wrong: what to do`.
"""

from collections.abc import Iterator

from gyrorig_protocol.recording.losses import Loss, LossCause
from gyrorig_solver.calibration.wording import collapsed
from gyrorig_solver.check.health import BoardHealth, Health
from gyrorig_solver.estimate.result import Observability

LOST_SHARE = 0.02  # more than this and a calibration is limited

_COPY = "copy it again from the rig if it is whole there, else go on with what is left"
_LOSSES = {
    LossCause.UNFINISHED: "`gyrorigd recover FOLDER` on the rig closes it, and nothing that "
    "was on the disk is lost",
    LossCause.TRUNCATED: _COPY,
    LossCause.DAMAGED: _COPY,
    LossCause.REFUSED: "it was not written by gyrorigd, or bytes were changed: " + _COPY,
    LossCause.MESSAGE: "the rest is used; record again if they are the samples",
    LossCause.SUMMARY: "no need to do anything, the file is read without it",
    LossCause.METADATA: "no need to do anything now, but check the disk that it was on",
    LossCause.MISSING: _COPY,
}
_FAULTS = "`gyrorigd doctor --config RIG.yaml` says whether it is still so"


def verdict(health: Health) -> str:
    """Return what to think of a recording, in a few words."""
    broken = [board.board for board in health.boards if board.fault]
    if len(broken) == len(health.boards):
        return "not usable"
    if broken:
        return f"usable in part: not {', '.join(broken)}"
    remarks = any(_about_quality(health)) or not health.complete
    if health.identifiable:
        return "usable, with remarks" if remarks else "sound"
    first = "usable, with remarks" if remarks else "sound"
    return f"{first}, but cannot calibrate all"


def problems(health: Health) -> tuple[str, ...]:
    """Return what is wrong, each with its remedy; nothing of a sound recording."""
    return (*_about_quality(health), *_about_capability(health))


def _loss_words(loss: Loss) -> str:
    """Return what is missing and what to do about it."""
    return f"{loss.text}: {_LOSSES[loss.cause]}"


def _about_quality(health: Health) -> Iterator[str]:
    """Yield what is wrong with the recording itself."""
    yield from (_loss_words(loss) for loss in health.losses)
    for topic, count in health.dropped.items():
        yield (
            f"{count} messages of {topic} were dropped by the daemon: its disk was full or too "
            "slow, so make room on it"
        )
    yield from (f"fault noted while recording, {text}: {_FAULTS}" for text in health.faults)
    if not health.boards:
        yield (
            "there is no board in it: connect one, and see with `gyrorigd doctor --config "
            "RIG.yaml` that it answers"
        )
    for board in health.boards:
        yield from _about_board(board)
    if health.unit is not None and health.unit.unsynchronised:
        yield (
            f"{health.unit.unsynchronised} positions were read out of step with the unit, and "
            "are left out: check its cable"
        )


def _about_board(board: BoardHealth) -> Iterator[str]:
    name = board.board
    if board.fault:
        yield f"{name} cannot be used, {board.fault}"
        return
    if board.lost > LOST_SHARE * (board.samples + board.lost):
        yield f"{name} lost {board.lost} samples: lower its output rate or raise its baud"
    if board.saturated > 0:
        yield (
            f"{name} has {board.saturated} saturated samples: "
            "use a larger full scale, or turn slower"
        )
    if board.repeated > LOST_SHARE * board.samples:
        yield (
            f"{name} repeats {board.repeated} samples, for it is read faster than it measures: "
            "read it when its data-ready says so, or raise its output rate"
        )
    if board.restarts:
        yield f"{name} started anew {board.restarts} times: check its supply and its cable"
    if board.clock_steps:
        yield (
            f"{name}'s clock or the host's jumped {board.clock_steps} times: "
            "do not suspend the host, check the board's firmware"
        )


def _about_capability(health: Health) -> Iterator[str]:
    """Yield what the motion cannot show."""
    for board in health.boards:
        if board.fault:
            continue
        if board.observability is None:
            yield f"{board.board} cannot be calibrated by this alone, {board.no_reference}"
        elif board.observability.unobservable:
            hidden = ", ".join(collapsed(board.observability.unobservable))
            yield f"{board.board} cannot show {hidden}: {_why(board.observability)}"


def _why(seen: Observability) -> str:
    return "; ".join(seen.reasons) or "turn it about every axis"
