"""Print the minimal detectable size of each cause under a program, next to its usual sizes.

The program uses the noise-free difference in one rig. The verdict is "never" if the cause is not
detectable at the largest size of real parts. Then no method can detect the cause, or exclude it.

Run: python tests/hidden/truth/visible.py [--programs survey-40 ...] [--soak KELVIN] [--seed N]
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.hidden.truth.detectable import compute_detectable
from tests.hidden.truth.draws import PROGRAMS, make_sizer
from tests.hidden.truth.session import RigDraw
from tests.hidden.truth.sizing import COUNTED, Sizer, VisibleSize

from gyrorig_daemon.emulator.injection import CAUSES, Cause


def judge_size(cause: type[Cause], sized: VisibleSize | None) -> str:
    """Return whether a cause is visible at its usual sizes."""
    if sized is None:
        return "never"
    size = abs(sized.size)
    if cause.name == "saturation":
        return "yes"
    if size <= cause.sampled_min:
        return "always"
    return "yes" if size <= cause.typical else "only when large"


def make_row(sizer: Sizer, cause: type[Cause], place: str) -> str:
    """Return a row of the table."""
    sized = sizer.find_cause_size(cause.name, place, 1.0, 1.0)
    if sized is None:
        largest = VisibleSize(
            cause.sampled_max,
            sizer.make_visibility_function(cause.name, place)(cause.sampled_max),
            compute_detectable(cause.name),
        )
        sized = largest if largest.times > 1.0 else None  # its visibility jumps beyond 1x
        shown = f"{largest.times:.2g}x at {cause.sampled_max:.2g}"
    else:
        shown = f"{abs(sized.size):.2g}"
        if sized.times > 1.1:
            shown += f" ({sized.times:.1f}x)"
    unit = "" if cause.unit == "1" else f" {cause.unit}"
    place_text = f"@{place}" if place else ""
    usual = f"{cause.sampled_min:.2g} to {cause.sampled_max:.2g}"
    return f"| {cause.name}{place_text} | {shown}{unit} | {usual} | {judge_size(cause, sized)} |"


def main() -> None:
    """Read the command line and print a table for each program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--programs", nargs="+", choices=list(PROGRAMS), default=list(PROGRAMS))
    parser.add_argument("--soak", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=5)
    arguments = parser.parse_args()
    for program in arguments.programs:
        sizer = make_sizer(RigDraw(arguments.seed, program, arguments.soak))
        head = f"{program}, soak {arguments.soak:g} K" if arguments.soak else program
        sys.stdout.write(
            f"\n{head}\n\n| cause | seen from | usual sizes | seen |\n|---|---|---|---|\n"
        )
        for cause in CAUSES.values():
            places = cause.components if cause.components and not cause.acts_on_all else ("",)
            for place in places if cause.name not in COUNTED else ():
                sys.stdout.write(make_row(sizer, cause, place) + "\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
