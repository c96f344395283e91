"""What a rig does by itself: the `schedule` and `service` parts of its document."""

import re
from typing import Annotated

import msgspec

from gyrorig_daemon.config.names import first_twice
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId

_TIME_OF_DAY = re.compile(r"([01][0-9]|2[0-3]):([0-5][0-9])")

Hours = Annotated[float, msgspec.Meta(ge=0.01, le=24.0 * 366)]


class ScheduleEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A session that comes again: every so many hours, or daily at a time of UTC."""

    name: str
    program: Annotated[str, msgspec.Meta(min_length=1, max_length=400)]  # beside the rig's file
    every_h: Hours | None = None
    at_utc: str | None = None  # "02:30"
    home: bool = False

    @property
    def minute_of_day(self) -> int | None:
        """When a daily entry is due, in minutes since midnight."""
        found = None if self.at_utc is None else _TIME_OF_DAY.fullmatch(self.at_utc)
        return None if found is None else 60 * int(found[1]) + int(found[2])


class ServiceSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How `gyrorigd run` goes about it."""

    # A session begins without the boards that are still missing after so long.
    board_patience_s: Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)] = 30.0
    # After a fault of the motion the recording goes on, but no longer than this.
    aftermath_s: Annotated[float, msgspec.Meta(ge=0.0, le=3_600.0)] = 600.0
    # A recording is cut into parts of this length and size.
    part_s: Annotated[float, msgspec.Meta(ge=10.0, le=86_400.0)] = 3_600.0
    part_mb: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 512
    # Less than this is never left free on the disk.
    reserve_mb: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 1_024
    # Recordings beyond these are deleted, the oldest first; left out, none ever is.
    keep_days: Annotated[float, msgspec.Meta(gt=0.0, le=36_600.0)] | None = None
    keep_mb: Annotated[int, msgspec.Meta(ge=1)] | None = None
    # The oldest are deleted when less than the reserve is free; else recording waits for room.
    delete_when_full: bool = False
    # What a calibration in one of these folders cites is kept; beside the state folder's own.
    stores: Annotated[tuple[str, ...], msgspec.Meta(max_length=20)] = ()


def check_schedule(entries: tuple[ScheduleEntry, ...], name: str) -> None:
    """Refuse a schedule that cannot be kept.

    Raises:
        UsageError: an entry is not one; the text names it.
    """
    for entry in entries:
        try:
            BoardId(entry.name)
        except InputError as fault:
            raise UsageError(f"{name}: schedule: {fault.what}", fault.remedy) from fault
        if (entry.every_h is None) == (entry.at_utc is None):
            raise UsageError(
                f"{name}: schedule: {entry.name} says "
                + ("not when" if entry.every_h is None else "twice when"),
                "give it every_h, or at_utc, not both",
            )
        if entry.at_utc is not None and entry.minute_of_day is None:
            raise UsageError(
                f"{name}: {entry.at_utc!r:.20} of {entry.name} is no time of day",
                'write it as "02:30", in quotes',
            )
    twice = first_twice(entry.name for entry in entries)
    if twice is not None:
        raise UsageError(
            f"{name} names {twice} of the schedule twice", "rename one: a result bears the name"
        )
