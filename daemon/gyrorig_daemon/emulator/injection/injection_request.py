"""Injection requests as text: CAUSE[@PLACE][:SIZE], or `random`."""

import math

from gyrorig_daemon.emulator.causes.cause import Cause
from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_daemon.emulator.injection.cause_catalogue import CAUSES
from gyrorig_protocol.errors import UsageError, sentence
from gyrorig_protocol.suggestions import did_you_mean

RANDOM = "random"


def parse_injection(text: str) -> InjectionRequest:
    """Parse one request.

    Args:
        text: a cause; after `@` an axis, a board, or both as BOARD.AXIS; after `:` a size in
            the unit of the cause. An omitted parameter is sampled from the seed.

    Raises:
        UsageError: the cause or its size is not valid.
    """
    head, colon, size_text = text.strip().partition(":")
    name, _, component = head.partition("@")
    if name == RANDOM:
        if colon or component:
            raise UsageError(
                f"the option --hide {text} is not valid, because `random` also chooses the place "
                "and the size of the error",
                "write only --hide random, or replace `random` by the name of an error",
            )
        return InjectionRequest(RANDOM)
    cause = CAUSES.get(name)
    if cause is None:
        hint = did_you_mean(name, [*CAUSES, RANDOM])
        raise UsageError(
            f"{name!r:.40} in the option --hide is not the name of a simulated error",
            f"{sentence(hint)} Run `gyrorigd causes` to list all names".lstrip(),
        )
    size = _parse_size(cause, size_text) if colon else None
    return InjectionRequest(name, component, size)


def _parse_size(cause: type[Cause], text: str) -> float:
    try:
        size = float(text)
    except ValueError:
        size = math.nan
    shown = f"give the size as a number in {cause.unit}, for example {cause.typical:g}"
    if not math.isfinite(size):
        raise UsageError(
            f"the size {text!r:.40} of the simulated error {cause.name} is not a number", shown
        )
    if size < 0.0 and not cause.is_signed:
        raise UsageError(
            f"the size of the simulated error {cause.name} is {size:g}, but it must not be "
            "negative",
            shown,
        )
    if not cause.min_size <= abs(size) <= cause.max_size:
        sign = ", positive or negative" if cause.is_signed else ""
        raise UsageError(
            f"the simulated error {cause.name} cannot have the size {size:g} {cause.unit}",
            f"give a size from {cause.min_size:g} to {cause.max_size:g} {cause.unit}{sign}, for "
            f"example {cause.typical:g}",
        )
    if cause.is_integer and size != round(size):
        raise UsageError(
            f"the size of the simulated error {cause.name} is {size:g}, but it must be a whole "
            "number",
            shown,
        )
    return size
