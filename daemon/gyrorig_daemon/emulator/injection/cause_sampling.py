"""Sampling of injected causes, and their application to a rig.

Everything is sampled from the rig's seed, in separate streams. Therefore injecting a cause
changes neither the rest of the truth nor the noise.
"""

import math
import zlib
from collections.abc import Sequence

import numpy as np

from gyrorig_daemon.emulator.causes.cause import Cause, InjectedCause, ParameterSampling, Quantity
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, InjectionRequest, RigSettings
from gyrorig_daemon.emulator.injection.cause_catalogue import CAUSES
from gyrorig_daemon.emulator.injection.injection_request import RANDOM
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_protocol.errors import UsageError, sentence
from gyrorig_protocol.suggestions import did_you_mean

_CAUSES_STREAM = 0x48494445  # different from every other stream of the seed
_CHOICE, _PARAMETERS, _RUN_TIME = range(3)


def sample_injected_causes(settings: RigSettings) -> tuple[InjectedCause, ...]:
    """Return the injected causes of a rig, a pure function of its settings.

    Raises:
        UsageError: a component is not one of the cause, a cause is injected twice, or a size is
            too large for this rig.
    """
    rng = np.random.default_rng([settings.seed, _CAUSES_STREAM, _CHOICE])
    requests: list[InjectionRequest] = []
    for request in settings.injections:
        if request.cause == RANDOM:
            chosen = {other.cause for other in requests}
            unused_names = [name for name in sorted(CAUSES) if name not in chosen]
            requests.append(InjectionRequest(str(rng.choice(unused_names))))
        else:
            requests.append(request)
    injected = tuple(_sample_cause(request, settings) for request in requests)
    keys = [(cause.cause, cause.board, cause.component) for cause in injected]
    for k, key in enumerate(keys):
        if key in keys[:k]:
            raise UsageError(
                f"the option --hide gives the simulated error {key[0]} twice for the same place",
                "name another axis or board after @, or give the error only once",
            )
    return injected


def apply_causes(
    injected: Sequence[InjectedCause], seed: int, session_seed: int | None = None
) -> RigHooks:
    """Return the hooks of a rig with these causes.

    Args:
        injected: the causes.
        seed: of the rig.
        session_seed: of effects that are random at run time; None: they follow from `seed`.
    """
    session = () if session_seed is None else (session_seed,)
    hooks = RigHooks()
    for cause in injected:
        key = _stream_key(cause.cause, cause.component, cause.board or "")
        rng = np.random.default_rng([seed, _CAUSES_STREAM, _RUN_TIME, key, *session])
        CAUSES[cause.cause].apply(cause, hooks, rng)
    return hooks


def _sample_cause(request: InjectionRequest, settings: RigSettings) -> InjectedCause:
    cause = CAUSES[request.cause]
    key = _stream_key(request.cause, request.component)
    rng = np.random.default_rng([settings.seed, _CAUSES_STREAM, _PARAMETERS, key])
    board, component = _sample_component(cause, request.component, settings, rng)
    max_size = cause.max_size_on(board)
    size = _sample_size(cause, max_size, rng)
    if request.size is not None:  # sampled all the same, so that later draws do not depend on it
        size = request.size
    if abs(size) > max_size:
        raise UsageError(
            f"the size {size:g} {cause.unit} of the simulated error {cause.name} is too large for "
            f"board {board.name}",
            f"give a size of at most {max_size:.3g} {cause.unit}",
        )
    sampling = ParameterSampling(size=size, component=component, rng=rng, rig=settings, board=board)
    return InjectedCause(
        cause=cause.name,
        part=cause.part,
        component=component or ",".join(cause.components) or "all",
        board=board.name if cause.is_on_board() else None,
        size=Quantity(size, cause.unit),
        parameters=cause.sample_parameters(sampling),
    )


def _sample_size(cause: type[Cause], max_size: float, rng: np.random.Generator) -> float:
    if cause.allowed_sizes:
        size = float(rng.choice(cause.allowed_sizes))
    else:
        scale = min(max_size / cause.sampled_max, 1.0)
        log_size = rng.uniform(math.log(cause.sampled_min), math.log(cause.sampled_max))
        size = scale * math.exp(log_size)
    return size * float(rng.choice((-1.0, 1.0))) if cause.is_signed else size


def _sample_component(
    cause: type[Cause], text: str, settings: RigSettings, rng: np.random.Generator
) -> tuple[BoardSettings, str]:
    """Return the board and the axis that a request names, sampled if it names none."""
    boards = {board.name: board for board in settings.boards}
    is_on_board = cause.is_on_board()
    if is_on_board and not boards:
        raise UsageError(
            f"the simulated error {cause.name} acts on a board, but no board of this rig is "
            "emulated",
            "write `emulated` as the port of a board, or choose an error that acts on the "
            "pan-tilt unit",
        )
    board = settings.boards[int(rng.integers(len(boards)))] if boards else BoardSettings()
    sampled = (
        str(rng.choice(cause.components)) if cause.components and not cause.acts_on_all else ""
    )
    head, _, axis = text.rpartition(".")
    if is_on_board and text in boards:
        return boards[text], sampled
    if is_on_board and head in boards and axis in cause.components:
        return boards[head], axis
    if text in cause.components:
        return board, text
    if text:
        places = [*cause.components, *(boards if is_on_board else ())]
        hint = sentence(did_you_mean(text, places))
        if places:
            remedy = f"{hint} After @, write one of {', '.join(places[:12])}".lstrip()
        else:
            remedy = f"write {cause.name} without @ and a place"
        raise UsageError(
            f"the simulated error {cause.name} cannot be applied to {text!r:.40}",
            remedy,
        )
    return board, sampled


def _stream_key(*words: str) -> int:
    return zlib.crc32("@".join(words).encode())
