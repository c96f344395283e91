"""What a desk does with recordings: the command `gyrorig`, and `Calibration` for programs.

from gyrorig_solver import Calibration   # arrays in, arrays out: see `apply.board_calibration`
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gyrorig_solver.apply import Calibration

__all__ = ["Calibration"]


def __getattr__(name: str) -> Any:
    """Load `Calibration` when it is asked for: the commands begin before numpy is there."""
    if name != "Calibration":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from gyrorig_solver.apply import Calibration  # noqa: PLC0415 - see above

    return Calibration
