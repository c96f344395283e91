"""The one tree of errors, sorted by who must act.

    GyrorigError                      exit code
    |-- UsageError                    2   the person at the command line, or the configuration
    |-- InputError                    3   whoever made the recording or document
    |-- DeviceError                   1   whoever can touch the unit, the board or the cable
    |-- MachineError                  1   whoever runs this computer (disk, permissions)
    `-- BusyError                     75  nobody: try again later

Each text is one line: what is wrong, and what to do about it. No caller decides
anything by reading a text; where a decision needs a detail, it is a field.
"""


class GyrorigError(Exception):
    """Base of every error that this project raises on purpose."""

    exit_code = 1

    def __init__(self, what: str, remedy: str = "") -> None:
        """Join what is wrong and what to do about it into one line."""
        super().__init__(f"{what}: {remedy}" if remedy else what)
        self.what = what
        self.remedy = remedy


class UsageError(GyrorigError):
    """A command, a configuration or a program asks for what cannot be done.

    Examples: an unknown key in rig.yaml; a program that turns past the unit's limits.
    """

    exit_code = 2


class InputError(GyrorigError):
    """An input file is damaged, empty, foreign, or does not hold what was asked of it.

    Examples: a recording without a board of that name; a document of an unknown schema.
    """

    exit_code = 3


class DeviceError(GyrorigError):
    """A device did not answer, answered an error, or is not the one it should be.

    Examples: a silent pan-tilt unit; a move refused; a limit reached.
    """

    exit_code = 1


class MachineError(GyrorigError):
    """This computer cannot do what it must. Examples: disk full, no permission."""

    exit_code = 1


class BusyError(GyrorigError):
    """Another process holds the port or the store; the same call may work later."""

    exit_code = 75
