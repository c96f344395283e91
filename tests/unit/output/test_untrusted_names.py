"""A name in a recording or a calibration makes no lines of its own in a table."""

from gyrorig_solver.commands.store_command import _table


def test_a_row_is_one_line() -> None:
    rows = [{"board": "B-1", "sensor": "MPU\n0 findings\r\nB-2"}]
    assert len(_table(rows, {"board": "BOARD", "sensor": "SENSOR"}).splitlines()) == 2
