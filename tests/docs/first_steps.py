# ruff: noqa: T201
"""How long a stranger takes, from a fresh clone: `python tests/docs/first_steps.py`.

To the first report, to a calibration of somebody else's measurement (BROAD, where it is beside the
checkout or in $GYRORIG_DATA), and to a calibration applied in C. Counts the commands typed, and the
seconds by the clock and of the processor. Needs a package index, or what pip has kept of one.
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


class Course:
    """Commands typed so far, and what they cost."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.commands = 0
        self.begun_s = time.monotonic()
        self.begun_cpu_s = self._cpu_s()

    def type(self, line: str) -> str:
        """Run one command line and return what it printed."""
        self.commands += 1
        process = subprocess.run(
            ["bash", "-c", line], cwd=self.folder, capture_output=True, text=True, check=False
        )
        if process.returncode not in (0, 4):
            raise SystemExit(f"{line}: left with {process.returncode}: {process.stderr[-500:]}")
        return process.stdout

    def reached(self, what: str) -> None:
        """Say what was reached."""
        took_s, cpu_s = time.monotonic() - self.begun_s, self._cpu_s() - self.begun_cpu_s
        print(f"{what}: {self.commands} commands, {took_s:.0f} s, {cpu_s:.0f} s of the processor")

    @staticmethod
    def _cpu_s() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime


def main() -> int:
    """Walk the whole way."""
    data = Path(os.environ.get("GYRORIG_DATA", ROOT.parent / "shared" / "data"))
    with tempfile.TemporaryDirectory() as name:
        course = Course(Path(name))
        course.type(f"git clone -q {ROOT} gyrorig")
        course.folder = Path(name) / "gyrorig"
        course.type("make demo")
        course.reached("the first report")
        course.type(". .venv/bin/activate")  # typed once; each of ours is a shell of its own
        at = ". .venv/bin/activate; "
        if (data / TRIAL).is_file():
            course.type(f"{at}gyrorig import broad {data / TRIAL} --board BROAD-1 --out 02.mcap")
            course.type(f"{at}gyrorig solve 02.mcap")
            course.reached("a calibration of somebody else's measurement")
        made = "demo/calibrations/*/v0001.yaml"
        course.type(f"{at}gyrorig export {made} --format c --name board -o board.h")
        (course.folder / "main.c").write_text(MAIN)
        course.type("gcc -O2 -o apply main.c -lm")
        output = course.type("./apply")
        course.reached("a calibration applied in C")
        print(f"  which says {output.strip()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
