"""How much of the joint effect of several causes their terms leave together, without noise.

What `completeness` does for one cause. Causes on one rig are a chain, so their effect is not
the sum of what each does alone: terms that are merely added leave a fifth of a gap's and a
rounded ramp's. Terms are begun where the finder's exact refit puts them, the one that
explains most first, the next beside it, and then fitted together.

Run: python tests/hidden/pairs.py [--program survey-40] [CAUSE[@PLACE]:SIZE,... ...]
"""

import argparse
import importlib.util
import sys
import time
from pathlib import Path
from types import ModuleType

from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.extended_fit import extend_fit
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.discover.testable_terms import count_tests, testable_terms
from gyrorig_solver.estimate import ConvergedFit, NuisanceProjector
from gyrorig_solver.model import value_names
from gyrorig_solver.model.catalogue import catalogue

GOAL = 0.005
SEED = 7
PAIRS = (
    "backlash@tilt:0.0012,s_curve:0.03",
    "backlash@pan:0.0012,s_curve:0.06",
    "backlash@pan:0.0012,eccentricity@pan:0.0009",
    "backlash@pan:0.0012,lost_steps@pan:8",
    "backlash@pan:0.0012,clock_step:0.02",
    "backlash@pan:0.0012,scale_asymmetry:0.004",
    "backlash@tilt:0.0012,tilt_sag:0.002",
    "s_curve:0.03,base_speed_jump:0.05",
    "s_curve:0.03,base_compliance@pan:5e-5",
    "acceleration_error:0.02,base_speed_jump:0.05",
    "board_slip:0.012,worm_error@pan:0.0004",
    "low_pass_lag:0.3,clock_step:0.01",
    "low_pass_lag:0.3,ringing@pan:0.05",
    "low_pass_lag:0.3,saturation:1.2",
    "scale_quadratic:0.004,clock_skew:0.0005",
)


def completeness() -> ModuleType:
    """Return the module for one cause; the tests' folders are no package."""
    path = Path(__file__).with_name("completeness.py")
    spec = importlib.util.spec_from_file_location("hidden_completeness", path)
    if spec is None or spec.loader is None:
        raise ImportError(path)
    if spec.name not in sys.modules:
        sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[spec.name])
    return sys.modules[spec.name]


def left_share(
    hidden: str, program: str = "survey-40", seed: int = SEED
) -> tuple[float, float, ConvergedFit]:
    """Return the share of causes' joint energy that their terms leave, the energy, the fit.

    Args:
        hidden: CAUSE[@PLACE][:SIZE] after a comma each.
        program: of config/programs.
        seed: of the rig and of what is drawn of the causes.
    """
    script = completeness()
    causes = hidden.split(",")
    floor = script.floor_of(program, None, seed)
    with script.noise_held():
        base = script._solved(program, None, seed, *causes)
        fit = together(base, [name.partition(":")[0].partition("@")[0] for name in causes])
    effect = script.energy(base) - floor
    return (script.energy(fit) - floor) / effect, effect, fit


def together(base: ConvergedFit, causes: list[str]) -> ConvergedFit:
    """Fit causes beside a base fit, from where the finder would begin."""
    solution, open_causes = base, list(causes)
    while open_causes:
        projection = NuisanceProjector.at_fit(solution)
        tests = count_tests(testable_terms(projection))
        candidates = []
        for cause in open_causes:
            term = catalogue()[cause]
            scores = scan_catalogue(projection, [term], tests, all_templates(projection, term))
            best = fit_best_place(projection, [s for s in scores if s.place is None])
            if best is not None:
                candidates.append(best[0])
        if not candidates:
            raise ValueError(f"{open_causes} could not be fitted")
        first = max(candidates, key=lambda candidate: candidate.delta_log_likelihood)
        solution = extend_fit(MotionFitSpace(solution), first.extension).solution
        open_causes.remove(first.extension.term.cause)
    return solution


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", default="survey-40")
    parser.add_argument("causes", nargs="*", metavar="CAUSE[@PLACE]:SIZE,...")
    arguments = parser.parse_args()
    sys.stdout.write(f"{'causes':48} {'effect':>11} {'share':>8}  seconds  values\n")
    for hidden in arguments.causes or PAIRS:
        begin = time.monotonic()
        share, effect, fit = left_share(hidden, arguments.program)
        words = " ".join(
            f"{fitted_term.term.cause}.{name}={value:.4g}"
            for fitted_term in fit.fitted_terms
            for name, value in zip(value_names(fitted_term.term), fitted_term.values, strict=True)
        )
        sys.stdout.write(
            f"{hidden:48} {effect:11.1f} {share:8.3%} {'' if share <= GOAL else '*':1} "
            f"{time.monotonic() - begin:6.1f}  {words}\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
