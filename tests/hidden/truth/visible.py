"""How large each cause has to be to be seen under a program, beside how large it may be.

One rig, without noise: the size at the minimal detectable non-centrality, by the truth's own
difference. A cause that does not get there at the largest size that a part has is
"never" under this program: no finder can find it, and none may say that it is absent.

Run: python tests/hidden/truth/visible.py [--programs survey-40 ...] [--soak KELVIN] [--seed N]
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.hidden.truth.detectable import detectable_of
from tests.hidden.truth.draws import PROGRAMS, sizer_of
from tests.hidden.truth.session import RigDraw
from tests.hidden.truth.sizing import COUNTED, Sizer, VisibleSize

from gyrorig_daemon.emulator.injection import CAUSES, Cause


def verdict(cause: type[Cause], sized: VisibleSize | None) -> str:
    """Return whether a cause shows at the sizes that it usually has."""
    if sized is None:
        return "never"
    size = abs(sized.size)
    if cause.name == "saturation":
        return "yes"
    if size <= cause.sampled_min:
        return "always"
    return "yes" if size <= cause.typical else "only when large"


def row(sizer: Sizer, cause: type[Cause], place: str) -> str:
    """Return a line of the table."""
    sized = sizer.size_of_cause(cause.name, place, 1.0, 1.0)
    if sized is None:
        top = VisibleSize(
            cause.sampled_max,
            sizer.of_cause(cause.name, place)(cause.sampled_max),
            detectable_of(cause.name),
        )
        sized = top if top.times > 1.0 else None  # it begins with a jump past 1x
        shown = f"{top.times:.2g}x at {cause.sampled_max:.2g}"
    else:
        shown = f"{abs(sized.size):.2g}"
        if sized.times > 1.1:
            shown += f" ({sized.times:.1f}x)"
    unit = "" if cause.unit == "1" else f" {cause.unit}"
    where = f"@{place}" if place else ""
    usual = f"{cause.sampled_min:.2g} to {cause.sampled_max:.2g}"
    return f"| {cause.name}{where} | {shown}{unit} | {usual} | {verdict(cause, sized)} |"


def main() -> None:
    """Read the command line and print a table for each program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--programs", nargs="+", choices=list(PROGRAMS), default=list(PROGRAMS))
    parser.add_argument("--soak", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=5)
    arguments = parser.parse_args()
    for program in arguments.programs:
        sizer = sizer_of(RigDraw(arguments.seed, program, arguments.soak))
        head = f"{program}, soak {arguments.soak:g} K" if arguments.soak else program
        sys.stdout.write(
            f"\n{head}\n\n| cause | seen from | usual sizes | seen |\n|---|---|---|---|\n"
        )
        for cause in CAUSES.values():
            places = cause.components if cause.components and not cause.acts_on_all else ("",)
            for place in places if cause.name not in COUNTED else ():
                sys.stdout.write(row(sizer, cause, place) + "\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
