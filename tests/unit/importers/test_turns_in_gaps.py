"""Known turns of an import map that begin or end in a gap of the samples."""

from pathlib import Path

import numpy as np
import pytest

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.importers import ImportMap, check_import_map, import_measurements
from gyrorig_solver.pipeline import fit_criticised, load_board

MAP = """
schema: gyrorig/import/1
board: "B1"
sensor: "X"
time: {{key: t, unit: s}}
gyro: {{keys: [g], unit: rad/s}}
static: [{{end_s: 4.9}}]
turns:
  - {{axis: [0.0, 0.0, 1.0], angle_deg: 360.0, std_deg: 0.1, over: {{{over}}}}}
"""
RATE_HZ, SCALE = 100.0, 1.012
BEGIN_S, END_S = 5.0, 10.0
IN_TIMES, IN_ROWS = "begin_s: 5.0, end_s: 10.001", "start: 500, end: 1001"


def fit(tmp_path: Path, over: str, left_out_s: tuple[float, float], empty: bool = False) -> GyroFit:
    """Import a rest and a turn without the rates of some time; return the fit.

    Args:
        tmp_path: a new folder.
        over: the section of the turn.
        left_out_s: begin and end of the time without rates, s.
        empty: its rows are there, without rates.
    """
    time_s = np.arange(int(15.0 * RATE_HZ)) / RATE_HZ
    rate = np.random.default_rng(3).normal(size=(time_s.size, 3)) * 1e-4
    turns = (time_s >= BEGIN_S) & (time_s < END_S)
    rate[turns, 2] += SCALE * 2.0 * np.pi / (END_S - BEGIN_S)
    lost = (time_s > left_out_s[0]) & (time_s < left_out_s[1])
    rate[lost] = np.nan
    rows = ~lost | empty
    np.savez(tmp_path / "in.npz", t=time_s[rows], g=rate[rows])
    document = parse_yaml(MAP.format(over=over), "map")
    mapping = check_import_map(convert_document(document, ImportMap, "map"), "map")
    path = import_measurements(tmp_path / "in.npz", mapping, tmp_path / "out.mcap").path
    return fit_criticised(load_board([read_recording(path)], "B1"), ()).fit


@pytest.mark.parametrize("over", [IN_TIMES, IN_ROWS])
def test_a_complete_turn_gives_the_scale(tmp_path: Path, over: str) -> None:
    assert fit(tmp_path, over, (0.0, 0.0)).gain[2, 2] == pytest.approx(SCALE, abs=1e-4)


@pytest.mark.parametrize("left_out_s", [(4.5, 6.0), (9.0, 11.0), (6.0, 7.0)])
@pytest.mark.parametrize(("over", "empty"), [(IN_TIMES, False), (IN_TIMES, True), (IN_ROWS, True)])
def test_a_turn_with_a_gap_at_its_begin_or_end_is_refused(
    tmp_path: Path, over: str, empty: bool, left_out_s: tuple[float, float]
) -> None:
    """Before, the scale was 0.81 if the gap was at the begin or at the end."""
    with pytest.raises(InputError, match=r"the turn at 5.* has no usable sample for 1"):
        fit(tmp_path, over, left_out_s, empty)


@pytest.mark.parametrize(
    ("over", "left_out_s", "text"),
    [
        ("begin_s: -1.0, end_s: 10.0", (0.0, 0.0), "begins 1 s before the first sample"),
        ("start: 0, end: 1001", (-1.0, 3.0), "begins 3 s before the first sample"),
        ("begin_s: 5.0, end_s: 17.0", (0.0, 0.0), r"ends 2\.01 s after the last sample"),
        ("begin_s: -1.0e+300, end_s: 10.0", (0.0, 0.0), r"begins 1e\+300 s before"),
    ],
)
def test_a_turn_outside_of_the_samples_is_refused(
    tmp_path: Path, over: str, left_out_s: tuple[float, float], text: str
) -> None:
    with pytest.raises(InputError, match=text):
        fit(tmp_path, over, left_out_s, empty=True)


@pytest.mark.parametrize("left_out_s", [(4.5, 5.05), (9.95, 10.5)])
def test_the_rate_beside_a_short_gap_continues_to_the_end(
    tmp_path: Path, left_out_s: tuple[float, float]
) -> None:
    """Before, the turn was shorter by the gap, and the scale smaller by 1 %."""
    gain = fit(tmp_path, "begin_s: 5.0, end_s: 9.991", left_out_s, empty=True).gain[2, 2]
    assert gain == pytest.approx(SCALE, abs=1e-3)
