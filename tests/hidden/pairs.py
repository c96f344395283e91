"""Measure the share of the joint effect of several causes that their terms leave, without noise.

`completeness` does the same for one cause. Causes of one rig act in sequence, so their joint effect
is not the sum of the separate effects. A sum of terms would leave a fifth of the effect of a gap
with a rounded ramp. The start values of the terms are those of the solver's exact refit. The
program adds the term with the largest gain first, and fits all terms together.

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


def load_completeness() -> ModuleType:
    """Return the module for one cause; the test folders are not a package."""
    path = Path(__file__).with_name("completeness.py")
    spec = importlib.util.spec_from_file_location("hidden_completeness", path)
    if spec is None or spec.loader is None:
        raise ImportError(path)
    if spec.name not in sys.modules:
        sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[spec.name])
    return sys.modules[spec.name]


def measure_residual_share(
    hidden: str, program: str = "survey-40", seed: int = SEED
) -> tuple[float, float, ConvergedFit]:
    """Return the share of the joint energy that the terms leave, the energy, and the fit.

    Args:
        hidden: CAUSE[@PLACE][:SIZE], with commas between causes.
        program: of config/programs.
        seed: of the rig and of the causes.
    """
    completeness = load_completeness()
    causes = hidden.split(",")
    floor = completeness.measure_floor(program, None, seed)
    with completeness.fix_noise():
        base = completeness.record_and_fit(program, None, seed, *causes)
        fit = fit_causes(base, [name.partition(":")[0].partition("@")[0] for name in causes])
    effect = completeness.compute_energy(base) - floor
    return (completeness.compute_energy(fit) - floor) / effect, effect, fit


def fit_causes(base: ConvergedFit, causes: list[str]) -> ConvergedFit:
    """Fit causes after a base fit, from the start values of the solver."""
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
        start_s = time.monotonic()
        share, effect, fit = measure_residual_share(hidden, arguments.program)
        values_text = " ".join(
            f"{fitted_term.term.cause}.{name}={value:.4g}"
            for fitted_term in fit.fitted_terms
            for name, value in zip(value_names(fitted_term.term), fitted_term.values, strict=True)
        )
        sys.stdout.write(
            f"{hidden:48} {effect:11.1f} {share:8.3%} {'' if share <= GOAL else '*':1} "
            f"{time.monotonic() - start_s:6.1f}  {values_text}\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
