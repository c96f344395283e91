"""From what was asked for to causes with parameters, and from these to a rig.

All of it comes from the rig's seed, in streams of its own: hiding a cause changes neither
the rest of the truth nor the noise.
"""

import math
import zlib
from collections.abc import Sequence

import numpy as np

from gyrorig_daemon.emulator.causes.cause import Cause, Draw, Hidden, Quantity
from gyrorig_daemon.emulator.causes.order import RANDOM
from gyrorig_daemon.emulator.causes.registry import CAUSES
from gyrorig_daemon.emulator.physics.effects.hooks import RigHooks
from gyrorig_daemon.emulator.settings import BoardSettings, HideOrder, RigSettings
from gyrorig_protocol.errors import UsageError

_STREAM = 0x48494445  # apart from every other stream of the seed
_CHOOSING, _DRAWING, _HAPPENING = range(3)


def draw_hidden(settings: RigSettings) -> tuple[Hidden, ...]:
    """Return what a rig hides, a pure function of its settings.

    Raises:
        UsageError: a place is none of the cause's, a cause is hidden twice, or a size is too
            large for this rig.
    """
    rng = np.random.default_rng([settings.seed, _STREAM, _CHOOSING])
    orders: list[HideOrder] = []
    for order in settings.hide:
        if order.cause == RANDOM:
            left = [name for name in sorted(CAUSES) if name not in {o.cause for o in orders}]
            orders.append(HideOrder(str(rng.choice(left))))
        else:
            orders.append(order)
    hidden = tuple(_drawn(order, settings) for order in orders)
    seen = [(one.cause, one.board, one.where) for one in hidden]
    for k, one in enumerate(seen):
        if one in seen[:k]:
            raise UsageError(f"{one[0]} is hidden twice", "name another place, or hide it once")
    return hidden


def hang(hidden: Sequence[Hidden], seed: int) -> RigHooks:
    """Return the hooks of a rig with these causes on it."""
    hooks = RigHooks()
    for one in hidden:
        rng = np.random.default_rng(
            [seed, _STREAM, _HAPPENING, _key(one.cause, one.where, one.board or "")]
        )
        CAUSES[one.cause].hang(one, hooks, rng)
    return hooks


def _drawn(order: HideOrder, settings: RigSettings) -> Hidden:
    cause = CAUSES[order.cause]
    rng = np.random.default_rng([settings.seed, _STREAM, _DRAWING, _key(order.cause, order.place)])
    board, place = _place(cause, order.place, settings, rng)
    most = cause.most if cause.most_on is None else cause.most_on(board)
    size = _drawn_size(cause, most, rng)
    if order.size is not None:  # drawn all the same, so that what follows does not depend on it
        size = order.size
    if abs(size) > most:
        raise UsageError(
            f"{cause.name} of {size:g} {cause.unit} is too much on board {board.name}",
            f"give at most {most:.3g}",
        )
    draw = Draw(size=size, place=place, rng=rng, rig=settings, board=board)
    return Hidden(
        cause=cause.name,
        part=cause.part,
        where=place or ",".join(cause.places) or "all",
        board=board.name if cause.on_board else None,
        size=Quantity(size, cause.unit),
        parameters=cause.draw(draw),
    )


def _drawn_size(cause: Cause, most: float, rng: np.random.Generator) -> float:
    if cause.sizes:
        size = float(rng.choice(cause.sizes))
    else:
        scale = min(most / cause.highest, 1.0)
        size = scale * math.exp(rng.uniform(math.log(cause.lowest), math.log(cause.highest)))
    return size * float(rng.choice((-1.0, 1.0))) if cause.signed else size


def _place(
    cause: Cause, text: str, settings: RigSettings, rng: np.random.Generator
) -> tuple[BoardSettings, str]:
    """Return the board and the axis that a place names, drawn where it does not."""
    boards = {board.name: board for board in settings.boards}
    if cause.on_board and not boards:
        raise UsageError(
            f"{cause.name} is a board's, and no board of this rig is emulated",
            "write `emulated` as the port of a board, or hide a cause of the unit",
        )
    board = settings.boards[int(rng.integers(len(boards)))] if boards else BoardSettings()
    drawn = str(rng.choice(cause.places)) if cause.places and not cause.together else ""
    head, _, axis = text.rpartition(".")
    if cause.on_board and text in boards:
        return boards[text], drawn
    if cause.on_board and head in boards and axis in cause.places:
        return boards[head], axis
    if text in cause.places:
        return board, text
    if text:
        where = [*cause.places, *(boards if cause.on_board else ())]
        known = f"one of: {', '.join(where)}" if where else "no place"
        raise UsageError(f"{cause.name} does not happen at {text!r:.40}", f"name {known}")
    return board, drawn


def _key(*words: str) -> int:
    return zlib.crc32("@".join(words).encode())
