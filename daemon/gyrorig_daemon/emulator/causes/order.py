"""What a person asks to hide, as text: CAUSE[@PLACE][:SIZE], or `random`."""

import math

from gyrorig_daemon.emulator.causes.cause import Cause
from gyrorig_daemon.emulator.causes.registry import CAUSES
from gyrorig_daemon.emulator.settings import HideOrder
from gyrorig_protocol.errors import UsageError

RANDOM = "random"


def parse_hide(text: str) -> HideOrder:
    """Return what to hide.

    Args:
        text: a cause; after `@` an axis, a board, or both as BOARD.AXIS; after `:` a size in
            the cause's own unit. What is left out is drawn from the seed.

    Raises:
        UsageError: there is no such cause, or its size makes no sense.
    """
    head, colon, size_text = text.strip().partition(":")
    name, _, place = head.partition("@")
    if name == RANDOM:
        if colon or place:
            raise UsageError(f"--hide {text} cannot have a size or place", "write --hide random")
        return HideOrder(RANDOM)
    cause = CAUSES.get(name)
    if cause is None:
        known = ", ".join([*sorted(CAUSES), RANDOM])
        raise UsageError(f"{name!r:.40} is no cause that can be hidden", f"name one of: {known}")
    size = _size(cause, size_text) if colon else None
    return HideOrder(name, place, size)


def _size(cause: Cause, text: str) -> float:
    try:
        size = float(text)
    except ValueError:
        size = math.nan
    shown = f"a size of {cause.name} is a number in {cause.unit}, such as {cause.typical:g}"
    if not math.isfinite(size):
        raise UsageError(f"{text!r:.40} is no size of {cause.name}", shown)
    if size < 0.0 and not cause.signed:
        raise UsageError(f"{cause.name} cannot have the negative size {size:g}", shown)
    if not cause.least <= abs(size) <= cause.most:
        limits = f"from {cause.least:g} to {cause.most:g}"
        raise UsageError(f"{cause.name} of {size:g} is out of bounds", f"{shown}, {limits}")
    if cause.whole and size != round(size):
        raise UsageError(f"{cause.name} of {size:g} is no whole number", shown)
    return size
