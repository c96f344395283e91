"""Recordings at rest, imported from simulated tables."""

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.support.simulated_soaks import Soak, SoakData, write_soak_csv

from gyrorig_solver import cli

MAP = """\
schema: gyrorig/import/1
board: IMU-7
sensor: MPU-6050
time: {key: t, unit: s}
gyro: {keys: [gx, gy, gz], unit: deg/s, full_scale_dps: 250.0}
static: [{}]
"""
ImportSoak = Callable[..., tuple[Path, SoakData]]


@pytest.fixture
def import_soak(tmp_path: Path) -> ImportSoak:
    """Import a simulated rest: the recording and what was simulated."""

    def make(
        soak: Soak, seed: int = 1, *, thermometer: bool = True, name: str = "soak"
    ) -> tuple[Path, SoakData]:
        table, column_map = tmp_path / f"{name}.csv", tmp_path / "map.yaml"
        simulated = write_soak_csv(table, soak, seed, rate_hz=10)
        column_map.write_text(MAP + ("temperature: {key: degc}\n" if thermometer else ""))
        out = tmp_path / f"{name}.mcap"
        command = ["import", "csv", str(table), "--map", str(column_map), "--out", str(out)]
        assert cli.run(command) == 0
        return out, simulated

    return make
