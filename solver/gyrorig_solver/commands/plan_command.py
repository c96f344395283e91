"""`gyrorig plan`: predict the uncertainties of a motion program, or search for the best one."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click
import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.profile import SensorProfile, parse_profile
from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.calibration import find_profile
from gyrorig_solver.calibration.unit_document import posterior_of
from gyrorig_solver.commands.project_files import project_names
from gyrorig_solver.commands.terminal import (
    NOT_IDENTIFIABLE,
    Terminal,
    choice_option,
    json_option,
    output_option,
)
from gyrorig_solver.pipeline import read_unit_file
from gyrorig_solver.plan import (
    DetectabilityReport,
    PlanResult,
    Prediction,
    RigModel,
    TotalPrediction,
    find_program,
    load_rig,
    predict_detectability,
    predict_program,
    predict_total,
    program_text,
    require_new_path,
    write_new_file,
)
from gyrorig_solver.plan.criterion import CRITERIA, Criterion, cost
from gyrorig_solver.plan.detectability_table import (
    DETECTION_TEXT,
    causes_notes,
    causes_summary,
    causes_table,
    causes_to_builtins,
)
from gyrorig_solver.plan.prediction_table import (
    contributions_text,
    predictions_table,
    undetermined_parameters,
)
from gyrorig_solver.plan.program_search import AIMS
from gyrorig_solver.plan.total_prediction import PlanPrior
from gyrorig_solver.uncertainty import default_settings, read_settings

UNKNOWN_UNIT = (
    "the prediction assumes the two axes, motor steps, accelerations and reply times of a PTU-E46, "
    "but the rig file has another unit"
)
MAX_LINES = 20  # of the output without --details
MAX_CAUSES = 3  # named of each program without --details
SHORTEST_S, LONGEST_S = 5.0, 900.0  # repeat a program for longer recordings
PROFILE_HINT = "a profile with --sensor, such as config/boards/L3G4200D.yaml"
PROGRAM_HINT = "a program with --program, such as config/programs/quick.yaml"


@click.command("plan")
@click.option(
    "--rig",
    "rig_path",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    help="The rig file (YAML), with limits and speeds.",
)
@click.option(
    "--seconds",
    type=float,
    help="Maximum length of the recording in seconds, 5 to 900.  [default: 75; with --program "
    "none]",
)
@click.option(
    "--program",
    "program_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help=(
        "Predict this motion program. Without --seconds, the command does not search for "
        "another one.  [default: none]"
    ),
)
@choice_option(
    "--criterion",
    CRITERIA,
    "worst",
    "The total standard uncertainty to minimise: of the gain's nine entries, or of its factors.",
)
@choice_option(
    "--for",
    AIMS,
    "calibration",
    "Search for the smallest uncertainties, or for the best separation of causes.",
    "aim",
)
@choice_option(
    "--minimise",
    ["total", "noise"],
    "total",
    "total: uncertainty from noise and from causes that the program does not determine; "
    "noise: from noise only.",
)
@click.option(
    "--uncertainty",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Prior sizes of the causes that differ from the shipped ones (YAML); docs/units.md "
    "describes them.  [default: the shipped ones]",
)
@click.option(
    "--unit-prior",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help=(
        "The unit posterior, which earlier recordings determined: a version in the folder "
        "rigs/<unit> of the results (YAML).  [default: the prior sizes]"
    ),
)
@click.option(
    "--sensor",
    help="A sensor profile: a name in config/boards, or a file.  [default: the rig's own]",
)
@output_option("Program to write, for gyrorigd record; it must not exist.  [default: none]")
@click.option(
    "--causes/--no-causes",
    default=True,
    show_default=True,
    help="Predict which causes of errors the program can detect.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed of the random programs that are tried.",
)
@click.option(
    "--details",
    is_flag=True,
    help="Print every cause and every note.",
)
@json_option
@click.pass_obj
def plan_command(terminal: Terminal, /, **options: Any) -> int:
    r"""Search for the motion program with the least uncertainties in a given time.

    Prints the total standard uncertainties that a calibration with the program will have, and
    their part from noise (type A) in parentheses. With --program it predicts that program; with
    --seconds too, both side by side. Then it prints the causes of errors that the program cannot
    detect. Exits with status 4 when the program leaves a parameter unobservable.

    \b
    Example:
      gyrorig plan --rig config/rig.yaml --seconds 75 --output planned.yaml
    """
    if options["out"] is not None:
        require_new_path(options["out"])
    rig = load_rig(options["rig_path"])
    sensor = rig.sensor(_sensor_profile(options["sensor"] or rig.sensor_name))
    seconds: float | None = options["seconds"]
    prior = _plan_prior(options["uncertainty"], options["unit_prior"])
    given_prediction: Prediction | None = None
    if options["program_path"] is not None:
        terminal.print_progress("predicting the given program")
        path = options["program_path"]
        program = parse_program(_read_file(path, PROGRAM_HINT), path.name)
        given_prediction = predict_program(program, rig.unit, sensor)
    elif seconds is None:
        seconds = 75.0
    plan_result: PlanResult | None = None
    if seconds is not None:
        if not SHORTEST_S <= seconds <= LONGEST_S:
            raise UsageError(
                f"the option --seconds gives the motion program a length of {seconds:g} s, but the "
                f"length must be from {SHORTEST_S:g} to {LONGEST_S:g} s",
                "give a length in this range. For a longer recording, repeat the motion program",
            )
        plan_result = find_program(
            rig.unit,
            sensor,
            seconds,
            options["criterion"],
            options["seed"],
            terminal.print_progress,
            options["aim"],
            rig.site,
            _without_causes(prior) if options["minimise"] == "noise" else prior,
        )
    elif options["out"] is not None:
        raise UsageError(
            "the option --output needs the option --seconds, because the command searches for a "
            "motion program only if its length is given",
            "give the length of the motion program with --seconds, or remove --output",
        )
    predictions = [
        p
        for p in (given_prediction, plan_result.prediction if plan_result else None)
        if p is not None
    ]
    totals = {id(p): predict_total(p, sensor, rig.site, prior) for p in predictions}
    lines = [
        f"{rig.name}, {sensor.name}: predicted total standard uncertainties (from noise)",
        *_prediction_lines(predictions, list(totals.values()), options["details"]),
    ]
    if not rig.is_unit_known:
        lines.append(f"  remark: {UNKNOWN_UNIT}")
    terminal.print_result("\n".join(lines))
    free_lines = MAX_LINES - len(lines) - len(predictions) - (plan_result is not None)
    shown_causes = max(0, min(MAX_CAUSES, free_lines // len(predictions)))
    outlooks: dict[int, DetectabilityReport] = {}
    if options["causes"]:
        for prediction in predictions:
            terminal.print_progress(f"predicting causes with {prediction.program.name}")
            known_outlook = (
                plan_result.detectability
                if plan_result and prediction is plan_result.prediction
                else None
            )
            outlooks[id(prediction)] = known_outlook or predict_detectability(
                prediction, sensor, rig.site
            )
            name, outlook = prediction.program.name, outlooks[id(prediction)]
            if options["details"]:
                _print_all_causes(terminal, name, outlook)
            else:
                summary = causes_summary(outlook, name, shown_causes)
                terminal.print_result("\n".join(summary))
    if plan_result is not None:
        _write_program(terminal, plan_result, rig, options)
    code = NOT_IDENTIFIABLE if predictions[-1].observability.unobservable else 0
    terminal.print_json(
        {
            "rig": rig.name,
            "sensor": sensor.name,
            "given": _prediction_json(given_prediction, options["criterion"], outlooks, totals)
            if given_prediction
            else None,
            "planned": _prediction_json(
                plan_result.prediction, options["criterion"], outlooks, totals
            )
            if plan_result
            else None,
            "judged": plan_result.design_count if plan_result else 0,
            "file": str(options["out"]) if plan_result and options["out"] else None,
            "exit_code": code,
        }
    )
    return code


def _plan_prior(uncertainty: Path | None, unit_prior: Path | None) -> PlanPrior:
    """Return what is known of the rig from files, or the shipped prior sizes.

    Raises:
        UsageError: a file cannot be read, or is not such a document.
        InputError: the posterior of the unit is damaged.
    """
    settings = default_settings() if uncertainty is None else read_settings(uncertainty)
    if unit_prior is None:
        return PlanPrior(settings)
    return PlanPrior(settings, posterior_of(read_unit_file(unit_prior), settings))


def _without_causes(prior: PlanPrior) -> PlanPrior:
    return PlanPrior(replace(prior.settings, prior_sizes=MappingProxyType({})))


def _sensor_profile(name: str) -> SensorProfile:
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        return parse_profile(_read_file(path, PROFILE_HINT), path.name)
    profile = find_profile(name)
    if profile is None:
        suggestion = did_you_mean(name, project_names("boards"))
        raise UsageError(
            f"the folder config/boards contains no profile of the sensor {name!r:.60}",
            f"{suggestion} Give the name of a profile, or a file, with --sensor".strip(),
        )
    return profile


def _read_file(path: Path, wanted: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as fault:
        raise UsageError(f"{path} cannot be read ({fault.strerror})", f"give {wanted}") from fault


def _write_program(
    terminal: Terminal, plan_result: PlanResult, rig: RigModel, options: dict[str, Any]
) -> None:
    criterion, out = options["criterion"], options["out"]
    if options["details"]:
        terminal.print_result(
            f"  the search selected this program from {plan_result.design_count} programs; its "
            f"{criterion} {'total ' if options['minimise'] == 'total' else ''}standard uncertainty "
            f"is {plan_result.cost:.3g}"
        )
    if out is None:
        terminal.print_result("  the option --output FILE writes the planned program")
        return
    program = plan_result.program
    text = program_text(
        MotionProgram(
            name=out.stem,
            steps=program.steps,
            settings=program.settings,
            description=_program_description(plan_result, options),
        )
    )
    arguments = [f"--{name} {options[name]}" for name in ("seconds", "criterion", "sensor", "seed")]
    arguments = [part for part in arguments if not part.endswith(" None")]
    if options["minimise"] == "noise":
        arguments.append("--minimise noise")
    header = (
        f"# Made by: gyrorig plan --rig {options['rig_path'].name} --for {options['aim']} "
        f"{' '.join(arguments)}\n"
    )
    parse_program(header + text, out.name)
    write_new_file(out, header + text)
    terminal.print_result(f"  program               {out}")


def _program_description(plan_result: PlanResult, options: dict[str, Any]) -> str:
    duration_text = f"{plan_result.prediction.duration_s:.1f} s"
    if options["aim"] == "causes":
        return f"planned to separate causes: {plan_result.design.poses} tilts, {duration_text}"
    return (
        f"planned for the smallest standard deviation (criterion {options['criterion']}) in "
        f"{duration_text}"
    )


def _prediction_lines(
    predictions: Sequence[Prediction], totals: Sequence[TotalPrediction], details: bool
) -> list[str]:
    """Return the table, and what programs cannot determine: in full for one or with details."""
    lines = predictions_table(predictions, totals, details).splitlines()
    if details and len(predictions) > 1:
        lines += [
            f"  largest contributions with {prediction.program.name}: {contributions_text(total)}"
            for prediction, total in zip(predictions, totals, strict=True)
        ]
    given = predictions[0]
    undetermined = undetermined_parameters(given)
    if undetermined:
        lines.append(f"  {given.program.name} cannot determine {', '.join(undetermined)}")
    if details or len(predictions) == 1:
        lines += [f"    {reason}" for reason in given.observability.reasons]
    return lines


def _print_all_causes(terminal: Terminal, name: str, outlook: DetectabilityReport) -> None:
    terminal.print_result(
        f"{name}: detectable sizes of causes ({DETECTION_TEXT})\n{causes_table(outlook)}"
    )
    for line in causes_notes(outlook):
        terminal.print_result(f"  {line}")


def _prediction_json(
    prediction: Prediction,
    criterion: Criterion,
    outlooks: dict[int, DetectabilityReport],
    totals: dict[int, TotalPrediction],
) -> dict[str, Any]:
    observability, outlook = prediction.observability, outlooks.get(id(prediction))
    return {
        "name": prediction.program.name,
        "duration_s": prediction.duration_s,
        "moves": prediction.move_count,
        "std": dict(prediction.std),
        "total": dict(totals[id(prediction)].std),
        "gain_std": np.asarray(prediction.gain_std).tolist(),
        "time_offset_by_motion_std_s": prediction.motion_offset_std_s,
        "cost": cost(prediction.decision, criterion),
        "total_cost": cost(totals[id(prediction)].decision, criterion),
        "observability": {
            "rank": observability.rank,
            "of": observability.of,
            "condition": observability.condition,
            "unobservable": list(observability.unobservable),
            "reasons": list(observability.reasons),
        },
        "causes": causes_to_builtins(outlook) if outlook else None,
    }
