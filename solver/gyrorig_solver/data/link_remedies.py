"""What to do about a fault, by the way on which the samples arrived.

A person who imported a file may have no board, no cable and no host that could be checked.

What to use when: a constant of this module for a fault of the samples; a new `LinkRemedy` for a
remedy that fits only a rig; `Term.remedy_for` for a cause of the catalogue.
"""

from dataclasses import dataclass

FILE_LINK = "file"  # of an imported recording; others are `serial` and `can`


@dataclass(frozen=True, slots=True)
class LinkRemedy:
    """What to do about a fault, without a full stop at its end. "": the same as at a rig."""

    rig: str  # for a serial line
    file: str = ""  # for a file that somebody recorded with another program
    can: str = ""  # for a CAN bus

    def for_link(self, link: str) -> str:
        """Return what to do.

        Args:
            link: the key `link` of the board's metadata. An unknown link is a serial line, as in
                recordings without this key.
        """
        return {FILE_LINK: self.file, "can": self.can}.get(link, "") or self.rig


LOST_SAMPLES = LinkRemedy(
    rig="lower the board's output rate, raise the baud rate, or reduce the load of the host",
    file=(
        "record again with a lower output rate or with a faster recorder, or ask the person who "
        "recorded the file for the missing samples"
    ),
    can=(
        "lower the board's output rate, raise the bit rate of the bus, or reduce the load of the "
        "host"
    ),
)
RESTART = LinkRemedy(
    rig="check the board's supply and its cable",
    file=(
        "if the file joins several recordings, import each of them separately; if not, ask the "
        "person who recorded the file why the board restarted"
    ),
)
CLOCK_STEP = LinkRemedy(
    rig="do not suspend the host, and check the board's firmware",
    file=(
        "import the rows before and after each jump of the times separately, or ask the person "
        "who recorded the file whether its clock was set"
    ),
)
REPEATS = LinkRemedy(
    rig=(
        "read the sensor on its data-ready signal or at its output rate, and check for a lossy "
        "radio link that repeats the last sample"
    ),
    file=(
        "use the samples as measured if the file was resampled, or ask the person who recorded "
        "the file for them"
    ),
)
DAMAGED_WORDS = LinkRemedy(
    rig=(
        "add a check sum to the frame, read the six bytes in one burst with block data update on, "
        "and check the speed, the pull-ups and the cable of the bus"
    ),
    file=(
        "copy the original file again and import it; if its samples are damaged too, remove these "
        "rows"
    ),
)
STUCK_AXIS = LinkRemedy(
    rig="check the register address and the power mode of that axis, and the sensor itself",
    file=(
        "look at this column in the original file: if it changes there, correct `keys` under "
        "`gyro` in the import map; if not, use another recording"
    ),
)
STUCK_SENSOR = LinkRemedy(
    rig="check the power mode and the register addresses of the sensor, and record again",
    file=(
        "look at the columns of the gyro in the original file: if they change there, correct "
        "`keys` under `gyro` in the import map; if not, use another recording"
    ),
)
WRONG_FULL_SCALE = LinkRemedy(
    rig=(
        "read back the range register, and set the board's full scale to that value; all rates "
        "are wrong by this factor until then"
    ),
    file=(
        "correct `unit` or `scale_rad_s` under `gyro` in the import map, and import the data "
        "again; all rates are wrong by this factor until then"
    ),
)
WRONG_SCALE = LinkRemedy(
    rig="check the full scale that the board reports",
    file="check the unit of the rates and of the times, and the full scale",
)
WRONG_AXES = LinkRemedy(
    rig="correct the order and the signs of the axes in the driver or in the board's columns",
    file=(
        "correct the order of the axes with `keys` under `gyro` in the import map, or their signs "
        "in the file"
    ),
)
OUTLIERS = LinkRemedy(
    rig="check the sensor's bus, its supply and the reference",
    file="check the reference, and look at these samples in the original file",
)
NO_SAMPLES = LinkRemedy(
    rig="record for longer, or check with `gyrorigd doctor` that the board sends samples",
    file="import a file with more samples",
)
NO_SAMPLE_RATE = LinkRemedy(
    rig="check the clock and `tick_hz` of the board, and record again",
    file="correct `time` in the import map, and import the data again",
)
WRONG_COUNTER = LinkRemedy(
    rig="check the timestamps and the sample counter of the board, and record again",
    file="correct `time` in the import map, and import the data again",
)
