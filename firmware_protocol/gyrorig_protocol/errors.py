"""The hierarchy of errors, sorted by who must act.

    GyrorigError                      exit code
    |-- UsageError                    2   the person at the command line, or the configuration
    |-- InputError                    3   whoever made the recording or document
    |-- DeviceError                   1   whoever can touch the unit, the board or the cable
    |-- MachineError                  1   whoever runs this computer (disk, permissions)
    `-- BusyError                     75  nobody: try again later

Each text is one line: what is wrong. What to do. No caller decides anything by reading a
text; where a decision needs a detail, it is a field.
"""

import re
from typing import Any

_COMMAND_WORDS = frozenset({"gyrorig", "gyrorigd", "sudo", "pip", "make", "systemctl", "apt"})
_PLAIN_WORD = re.compile(r"[a-z]+(?=[ ,;:]|\.?(?: |$))")


def sentence(text: str) -> str:
    """Return `text` as a sentence: a capital letter and a full stop.

    A command, a path or an identifier at the start keeps its spelling.
    """
    if not text:
        return text
    first_word = _PLAIN_WORD.match(text)
    if first_word and first_word.group() not in _COMMAND_WORDS:
        text = text[0].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else text + "."


class GyrorigError(Exception):
    """Base of every error that this project raises on purpose."""

    exit_code = 1

    def __init__(self, problem: str, remedy: str = "") -> None:
        """Join two sentences into one line: the problem, and the remedy if there is one.

        Args:
            problem: a clause without a final full stop, for example "the port is busy".
            remedy: an imperative, for example "stop the other program".
        """
        super().__init__(f"{problem.rstrip('.')}. {sentence(remedy)}" if remedy else problem)
        self.problem = problem
        self.remedy = remedy

    def __reduce__(self) -> tuple[Any, ...]:
        """Let a process send the error to another one, whatever its constructor takes."""
        return _restore_error, (type(self), self.args, self.__dict__)


def _restore_error(
    kind: type[GyrorigError], arguments: tuple[str, ...], fields: dict[str, Any]
) -> GyrorigError:
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(fields)
    return error


class UsageError(GyrorigError):
    """A command, a configuration or a motion program requests something impossible.

    Examples: an unknown key in rig.yaml; a program that turns past the unit's limits.
    """

    exit_code = 2


class InputError(GyrorigError):
    """An input file is damaged, empty, of another kind, or lacks the requested data.

    Examples: a recording without a board of that name; a document of an unknown schema.
    """

    exit_code = 3


class DeviceError(GyrorigError):
    """A device did not answer, answered with an error, or is not the expected one.

    Examples: a silent pan-tilt unit; a move refused; a limit reached.
    """

    exit_code = 1


class MachineError(GyrorigError):
    """This computer failed. Examples: disk full, no permission."""

    exit_code = 1


class BusyError(GyrorigError):
    """Another process uses the port or the store; the same call can succeed later."""

    exit_code = 75
