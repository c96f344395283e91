"""Settings of the service: the `schedule` and `service` parts of a rig document."""

import re
from typing import Annotated

import msgspec

from gyrorig_daemon.config.bus_config import first_duplicate
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId

_TIME_OF_DAY = re.compile(r"([01][0-9]|2[0-3]):([0-5][0-9])")

Hours = Annotated[float, msgspec.Meta(ge=0.01, le=24.0 * 366)]


class ScheduleEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A repeated session: at an interval in hours, or daily at a time in UTC."""

    name: str
    program: Annotated[
        str, msgspec.Meta(min_length=1, max_length=400)
    ]  # relative to the rig's file
    every_h: Hours | None = None
    at_utc: str | None = None  # "02:30"
    home: bool = False

    @property
    def minute_of_day(self) -> int | None:
        """Time of day of a daily entry, in minutes since midnight."""
        match = None if self.at_utc is None else _TIME_OF_DAY.fullmatch(self.at_utc)
        return None if match is None else 60 * int(match[1]) + int(match[2])


class ServiceSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of `gyrorigd run`."""

    # After this time a session starts without the missing boards.
    board_patience_s: Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)] = 30.0
    # Longest time that a recording continues after a motion fault.
    aftermath_s: Annotated[float, msgspec.Meta(ge=0.0, le=3_600.0)] = 600.0
    # A recording is split into parts of this length and size.
    part_s: Annotated[float, msgspec.Meta(ge=10.0, le=86_400.0)] = 3_600.0
    part_mb: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 512
    # Free disk space that recordings never use.
    reserve_mb: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 1_024
    # Recordings beyond these limits are deleted, the oldest first; by default none is.
    keep_days: Annotated[float, msgspec.Meta(gt=0.0, le=36_600.0)] | None = None
    keep_mb: Annotated[int, msgspec.Meta(ge=1)] | None = None
    # Delete the oldest when less than the reserve is free; otherwise recording waits.
    delete_when_full: bool = False
    # Motion programs that the solver proposes may move a real unit, with nobody there.
    run_proposed_programs: bool = False
    # Additional calibration folders; recordings that their calibrations reference are kept.
    stores: Annotated[tuple[str, ...], msgspec.Meta(max_length=20)] = ()


def validate_schedule(entries: tuple[ScheduleEntry, ...], name: str) -> None:
    """Reject an invalid schedule.

    Raises:
        UsageError: an entry is invalid; the text names it.
    """
    for entry in entries:
        try:
            BoardId(entry.name)
        except InputError as error:
            raise UsageError(
                f"{name}: in the schedule, {entry.name[:40]!r} is not a valid name of an entry",
                error.remedy,
            ) from error
        if (entry.every_h is None) == (entry.at_utc is None):
            raise UsageError(
                f"{name}: in the schedule, the entry {entry.name} has "
                + ("no time" if entry.every_h is None else "two times"),
                "give the entry either `every_h` or `at_utc`",
            )
        if entry.at_utc is not None and entry.minute_of_day is None:
            raise UsageError(
                f"{name}: in the schedule, the entry {entry.name} has {entry.at_utc!r:.20} "
                "as `at_utc`, which is not a time of day",
                'write the time as "02:30", in quotes',
            )
    duplicate = first_duplicate(entry.name for entry in entries)
    if duplicate is not None:
        raise UsageError(
            f"{name}: the schedule contains two entries with the name {duplicate}",
            "give each entry a different `name`",
        )
