"""Draw Figures 4 to 10 of the paper from a simulation, in docs/paper/figures/.

    python docs/paper/draw_figures.py

The data of the paper are not published. The figures show the results of its method for two
simulated boards on path A, which the text of the paper describes. `figures` is the table of their
numbers.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import matplotlib as mpl
import numpy as np
from docs.markdown import Block, number, numbers, show, table
from docs.paper.check_estimators import true_gain
from docs.paper.motion import (
    RATE_HZ,
    Motion,
    along,
    calibrated,
    paths,
    rotation_about_tilt_axis,
    white_noise_rad_s,
)
from docs.paper.printed import GY80, MPU, PrintedBoard
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.paper.paper_angles import integrated_rad
from gyrorig_solver.estimate.paper.paper_method import BiasSource, PaperResult

FIGURES = Path(__file__).resolve().parent / "figures"
AXES = ("x, tilt", "y, roll", "z, pan")
COLOURS = ("tab:blue", "tab:orange", "tab:green")
EVERY = 10  # drawn at 10 Hz


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedBoard:
    """A simulated board on the paper's two tests."""

    board: PrintedBoard
    gain: FloatArray  # (3, 3), the truth
    motion: Motion
    rate_rad_s: FloatArray  # (n, 3)

    def by(self, bias: BiasSource) -> PaperResult:
        """The paper's method with one of its biases."""
        return calibrated(self.motion, self.rate_rad_s, bias)


def simulated(board: PrintedBoard, gain: FloatArray, static_s: float, seed: int) -> SimulatedBoard:
    """`board` with `gain`, Table 2's static bias as degrees per second, and noise, on path A."""
    motion = along(next(iter(paths().values())), static_s=static_s)
    noise = white_noise_rad_s(motion.time_s.size, seed, RATE_HZ)
    rate = motion.body_rate_rad_s() @ gain.T + np.radians(board.bias_static) + noise
    return SimulatedBoard(board, gain, motion, np.asarray(rate))


def gy80() -> SimulatedBoard:
    """The GY80 of check_estimators.py; static test of 100 s (section III)."""
    return simulated(GY80, true_gain(), static_s=100.0, seed=4)


def mpu6515() -> SimulatedBoard:
    """The MPU 6515: Table 3's scales, a mount of -1.8 degrees; static test of 30 s (section IV)."""
    gain = MPU.S @ rotation_about_tilt_axis(np.radians(-1.8))
    return simulated(MPU, np.asarray(gain), static_s=30.0, seed=8)


def corrected_rad(result: PaperResult) -> FloatArray:
    """Angles after calibration: STM^-1 Y, or STM^+ Y where STM has no inverse."""
    return np.asarray(np.linalg.pinv(result.STM, rcond=1e-6) @ result.Y_rad)


def rms_deg(apart_rad: FloatArray) -> FloatArray:
    """Root mean square of each row in degrees."""
    return np.asarray(np.degrees(np.sqrt((apart_rad**2).mean(axis=1))))


def table_of_errors() -> str:
    """Figures 7 and 10: distance from the reference before and after calibration."""
    rows = []
    for case in (gy80(), mpu6515()):
        for bias in ("static", "quasi_static"):
            result = case.by(bias)
            before = rms_deg(result.Y_rad - result.U_rad)
            after = rms_deg(corrected_rad(result) - result.U_rad)
            seen = np.abs(result.STM - case.gain)[:, [0, 2]].max()
            rows.append(
                [
                    case.board.name,
                    bias.replace("_", "-"),
                    numbers(np.degrees(result.bias_rad_s), 3),
                    numbers(before, 2),
                    numbers(after, 2),
                    number(float(seen), 3),
                ]
            )
    head = ["simulated board", "bias", "bias value x, y, z, °/s", "rms error before x, y, z, °"]
    return table(
        [*head, "rms error after x, y, z, °", "largest error in columns x and z of STM"], rows
    )


def _three(axes: Axes, time_s: FloatArray, rows_rad: FloatArray, style: str = "-") -> None:
    for row, colour, name in zip(np.degrees(rows_rad), COLOURS, AXES, strict=True):
        label = name if style == "-" else None
        axes.plot(time_s[::EVERY], row[::EVERY], style, color=colour, label=label, linewidth=1.0)
    axes.set_xlabel("time, s")
    axes.set_ylabel("angle, °")
    axes.grid(visible=True, linewidth=0.3)


def _panels(title: str, left: str, right: str) -> tuple[Figure, Axes, Axes]:
    figure = Figure(figsize=(8.0, 3.0), layout="constrained")
    first, second = figure.subplots(1, 2)
    figure.suptitle(title, fontsize=10)
    first.set_title(f"(a) {left}", fontsize=9)
    second.set_title(f"(b) {right}", fontsize=9)
    return figure, first, second


def reference_figure() -> Figure:
    """Figure 4: eq. 12 on path A, and on a path whose tilt moves while pan is not zero."""
    figure, first, second = _panels(
        "Fig. 4, simulated: solid eq. 12 as printed, dotted the unit's true angles",
        "path A: tilt moves at pan 0",
        "path D: the same tilt at pan 60°",
    )
    runs = list(paths().items())
    for axes, start in ((first, "A pan"), (second, "D tilt")):
        motion = along(next(corners for name, corners in runs if name.startswith(start)))
        result = calibrated(motion, motion.body_rate_rad_s(), "static")
        moving = ~motion.static
        pan, tilt = motion.pan_rad[moving], motion.tilt_rad[moving]
        _three(axes, result.time_s, result.U_rad)
        _three(axes, result.time_s, np.vstack((tilt, 0.0 * tilt, pan)), ":")
    first.legend(fontsize=7)
    return figure


def static_figure(case: SimulatedBoard, number_in_paper: int) -> Figure:
    """Figures 5 and 8: the integrated static test, and the same without its slope."""
    figure, first, second = _panels(
        f"Fig. {number_in_paper}, simulated {case.board.name}: static test",
        "integrated",
        "without the bias",
    )
    still = case.motion.static
    time_s = case.motion.time_s[still] - case.motion.time_s[0]
    angle = integrated_rad(time_s, case.rate_rad_s[still])
    bias = case.by("quasi_static").bias_static_rad_s
    if bias is None:
        raise ValueError("the simulated board has no static test")
    _three(first, time_s, angle.T)
    _three(second, time_s, (angle - bias * time_s[:, None]).T)
    first.legend(fontsize=7)
    return figure


def quasi_static_figure(case: SimulatedBoard, number_in_paper: int) -> Figure:
    """Figures 6 and 9: the integrated cycles with the fitted line, and without it."""
    figure, first, second = _panels(
        f"Fig. {number_in_paper}, simulated {case.board.name}: quasi-static test",
        "integrated, and the lines fitted to it",
        "without the lines",
    )
    result = case.by("quasi_static")
    line = result.bias_rad_s[:, None] * result.time_s
    raw = result.Y_rad + line
    offset = (raw - line).mean(axis=1, keepdims=True)
    _three(first, result.time_s, raw)
    _three(first, result.time_s, line + offset, "--")
    _three(second, result.time_s, result.Y_rad)
    first.legend(fontsize=7)
    return figure


def corrected_figure(case: SimulatedBoard, number_in_paper: int) -> Figure:
    """Figures 7 and 10: measured and reference angles, before and after calibration."""
    figure, first, second = _panels(
        f"Fig. {number_in_paper}, simulated {case.board.name}: solid measured, dotted reference",
        "uncalibrated",
        "calibrated by eq. 7",
    )
    result = case.by("quasi_static")
    for axes, angle in ((first, result.Y_rad), (second, corrected_rad(result))):
        _three(axes, result.time_s, angle)
        _three(axes, result.time_s, result.U_rad, ":")
    first.legend(fontsize=7)
    return figure


def draw(folder: Path = FIGURES) -> list[Path]:
    """Write every figure as a PNG into `folder` and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    first, second = gy80(), mpu6515()
    figures = {
        4: reference_figure(),
        5: static_figure(first, 5),
        6: quasi_static_figure(first, 6),
        7: corrected_figure(first, 7),
        8: static_figure(second, 8),
        9: quasi_static_figure(second, 9),
        10: corrected_figure(second, 10),
    }
    files = []
    with mpl.rc_context({"font.size": 8}):
        for number_in_paper, figure in figures.items():
            file = folder / f"figure-{number_in_paper:02d}.png"
            figure.savefig(file, dpi=90, metadata={"Software": None})
            files.append(file)
    return files


BLOCKS: dict[str, Block] = {"figures": table_of_errors}

if __name__ == "__main__":
    show(BLOCKS)
    for drawn in draw():
        print(f"{drawn.name}: {drawn.stat().st_size / 1000.0:.0f} kB")
