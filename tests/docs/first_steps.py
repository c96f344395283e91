# ruff: noqa: T201
"""Measure the time that a new user needs: `python tests/docs/first_steps.py`.

The user starts with a fresh clone. The script measures the time until the first report, until a
calibration from data of others, and until a calibration is applied in C. The data are BROAD, next
to the checkout or in $GYRORIG_DATA; without them, the script omits this step. The script counts
commands, elapsed seconds and seconds of CPU time. It needs a package index or the cache of pip.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TRIAL = "broad/02_undisturbed_slow_rotation_B.npz"
MAIN = """
#include <stdio.h>
#include "board.h"
int main(void) {
  const int32_t counts[3] = {120, -34, 5};
  float rate[3];
  if (board_self_test() != 0) { puts("self-test failed"); return 1; }
  board_rate_float(counts, rate);
  printf("%.6f %.6f %.6f rad/s\\n", (double)rate[0], (double)rate[1], (double)rate[2]);
  return 0;
}
"""


class NewUser:
    """A user who types commands, and the time that they need."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.commands = 0
        self.start_s = time.monotonic()
        self.start_cpu_s = self._cpu_s()

    def run_command(self, line: str) -> str:
        """Run one command line, and return its output."""
        self.commands += 1
        process = subprocess.run(
            ["bash", "-c", line], cwd=self.folder, capture_output=True, text=True, check=False
        )
        if process.returncode not in (0, 4):
            raise SystemExit(
                f"{line}: exited with status {process.returncode}: {process.stderr[-500:]}"
            )
        return process.stdout

    def print_cost(self, result: str) -> None:
        """Print the number of commands and the time until a result."""
        took_s, cpu_s = time.monotonic() - self.start_s, self._cpu_s() - self.start_cpu_s
        print(f"{result}: {self.commands} commands, {took_s:.0f} s, {cpu_s:.0f} s of CPU time")

    @staticmethod
    def _cpu_s() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime


def main() -> int:
    """Run all steps, and print the cost of each."""
    data = Path(os.environ.get("GYRORIG_DATA", ROOT.parent / "shared" / "data"))
    with tempfile.TemporaryDirectory() as name:
        user = NewUser(Path(name))
        user.run_command(f"git clone -q {ROOT} gyrorig")
        user.folder = Path(name) / "gyrorig"
        user.run_command("make demo")
        user.print_cost("the first report")
        user.run_command(". .venv/bin/activate")  # each command here runs in a new shell
        activate = ". .venv/bin/activate; "
        if (data / TRIAL).is_file():
            user.run_command(
                f"{activate}gyrorig import broad {data / TRIAL} --board BROAD-1 --out 02.mcap"
            )
            user.run_command(f"{activate}gyrorig solve 02.mcap")
            user.print_cost("a calibration from data of others")
        calibration = "demo/calibrations/*/v0001.yaml"
        user.run_command(
            f"{activate}gyrorig export {calibration} --format c --name board -o board.h"
        )
        (user.folder / "main.c").write_text(MAIN)
        user.run_command("gcc -O2 -o apply main.c -lm")
        output = user.run_command("./apply")
        user.print_cost("a calibration applied in C")
        print(f"  its output: {output.strip()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
