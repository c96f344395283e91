"""`gyrorig plan`: what a program will tell, and the one that tells most, before motors move."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.profile import SensorProfile, parse_profile
from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_solver.calibration.profiles import find_profile
from gyrorig_solver.commands.terminal import NOT_IDENTIFIABLE, Terminal, json_option
from gyrorig_solver.plan.cause_words import causes_plain, causes_remarks, causes_table
from gyrorig_solver.plan.causes import Outlook, foresee
from gyrorig_solver.plan.criterion import CRITERIA, Criterion, cost
from gyrorig_solver.plan.document import check_new, program_text, write_new
from gyrorig_solver.plan.predict import Prediction, predict
from gyrorig_solver.plan.rig import Rig, load_rig
from gyrorig_solver.plan.search import AIMS, Found, find_program
from gyrorig_solver.plan.words import hidden, table

SHORTEST_S, LONGEST_S = 5.0, 900.0  # for more, carry a program out again
PROFILE = "a profile with --sensor, such as config/boards/L3G4200D.yaml"
PROGRAM = "a program with --program, such as config/programs/quick.yaml"


@click.command("plan")
@click.option(
    "--rig",
    "rig_path",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    help="The rig (YAML): its limits and speeds.",
)
@click.option(
    "--seconds",
    type=float,
    help="How long a recording may last, in seconds, 5 to 900.  [default: 75; with --program none]",
)
@click.option(
    "--program",
    "program_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Predict this program; without --seconds nothing is searched.  [default: none]",
)
@click.option(
    "--criterion",
    type=click.Choice(CRITERIA),
    default="worst",
    show_default=True,
    help="Which standard deviation counts: of the gain's nine entries, or of its factors.",
)
@click.option(
    "--for",
    "aim",
    type=click.Choice(AIMS),
    default="calibration",
    show_default=True,
    help="Least standard deviations, or causes of an error told apart.",
)
@click.option(
    "--sensor",
    help="A sensor profile: a name in config/boards, or a file.  [default: the rig's own]",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A file to write the program to, for gyrorigd record.  [default: none]",
)
@click.option(
    "--causes/--no-causes",
    default=True,
    show_default=True,
    help="Say what the program shows of the causes of an error.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Another number draws other programs to choose from.",
)
@json_option
@click.pass_obj
def plan_command(terminal: Terminal, /, **options: Any) -> int:
    r"""Find the motion program that tells most about a board in a given time.

    Prints the standard deviations that a calibration made with it will have. With
    --program it prints those of that program; with both, side by side. Then how large
    each cause of an error must be to be detected, and which look alike. Leaves with 4
    when the program that it judges cannot show a parameter.

    \b
    Example:
      gyrorig plan --rig config/rig.yaml --seconds 75 --out planned.yaml
    """
    if options["out"] is not None:
        check_new(options["out"])
    rig = load_rig(options["rig_path"])
    sensor = rig.sensor(_profile(options["sensor"] or rig.sensor_name))
    seconds: float | None = options["seconds"]
    given: Prediction | None = None
    if options["program_path"] is not None:
        terminal.progress("predicting the program given")
        given = predict(_program(options["program_path"]), rig.unit, sensor)
    elif seconds is None:
        seconds = 75.0
    found: Found | None = None
    if seconds is not None:
        if not SHORTEST_S <= seconds <= LONGEST_S:
            raise UsageError(
                f"--seconds {seconds:g} is out of reach",
                f"give {SHORTEST_S:g} to {LONGEST_S:g} s; for more, carry a program out again",
            )
        found = find_program(
            rig.unit,
            sensor,
            seconds,
            options["criterion"],
            options["seed"],
            terminal.progress,
            options["aim"],
            rig.site,
        )
    elif options["out"] is not None:
        raise UsageError("--out without --seconds has nothing to write", "give --seconds")
    shown = [p for p in (given, found.prediction if found else None) if p is not None]
    terminal.say(f"{rig.name}, {sensor.name}: predicted standard deviations\n{table(shown)}")
    for reason in hidden(shown[0]):
        terminal.say(f"  {shown[0].program.name} cannot show {reason}")
    outlooks: dict[int, Outlook] = {}
    if options["causes"]:
        for one in shown:
            terminal.progress(f"looking for causes in {one.program.name}")
            known = found.outlook if found and one is found.prediction else None
            outlooks[id(one)] = known or foresee(one, sensor, rig.site)
            _say_causes(terminal, one, outlooks[id(one)])
    if found is not None:
        _write(terminal, found, rig, options)
    code = NOT_IDENTIFIABLE if shown[-1].observability.unobservable else 0
    terminal.emit(
        {
            "rig": rig.name,
            "sensor": sensor.name,
            "given": _plain(given, options["criterion"], outlooks) if given else None,
            "planned": _plain(found.prediction, options["criterion"], outlooks) if found else None,
            "judged": found.judged if found else 0,
            "file": str(options["out"]) if found and options["out"] else None,
            "exit_code": code,
        }
    )
    return code


def _profile(named: str) -> SensorProfile:
    path = Path(named)
    if path.suffix in (".yaml", ".yml"):
        return parse_profile(_read(path, PROFILE), path.name)
    profile = find_profile(named)
    if profile is None:
        raise UsageError(
            f"no profile of {named!r:.60} in config/boards",
            "name one that is there with --sensor, such as L3G4200D, or a file of your own",
        )
    return profile


def _program(path: Path) -> MotionProgram:
    return parse_program(_read(path, PROGRAM), path.name)


def _read(path: Path, wanted: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as fault:
        raise UsageError(f"{path} cannot be read, {fault.strerror}", f"name {wanted}") from fault


def _write(terminal: Terminal, found: Found, rig: Rig, options: dict[str, Any]) -> None:
    """Say what was chosen, and write it where it was asked for."""
    criterion, out = options["criterion"], options["out"]
    terminal.say(
        f"  chosen from {found.judged} programs: {criterion} standard deviation "
        f"{found.cost * 1e6:.1f} ppm"
    )
    if out is None:
        terminal.say("  give --out FILE to write it")
        return
    program = found.program
    text = program_text(
        MotionProgram(
            name=out.stem,
            steps=program.steps,
            settings=program.settings,
            description=_described(found, options),
        )
    )
    asked = [f"--{name} {options[name]}" for name in ("seconds", "criterion", "sensor", "seed")]
    asked = [part for part in asked if not part.endswith(" None")]
    header = (
        f"# Made by: gyrorig plan --rig {options['rig_path'].name} --for {options['aim']} "
        f"{' '.join(asked)}\n"
    )
    parse_program(header + text, out.name)
    write_new(out, header + text)
    terminal.say(f"  program               {out}")


def _described(found: Found, options: dict[str, Any]) -> str:
    lasts = f"{found.prediction.duration_s:.1f} s"
    if options["aim"] == "causes":
        return f"planned to tell causes apart: {found.design.poses} tilts, {lasts}"
    return f"planned for the least {options['criterion']} standard deviation in {lasts}"


def _say_causes(terminal: Terminal, of: Prediction, outlook: Outlook) -> None:
    terminal.say(
        f"{of.program.name}: how large a cause must be to be detected (80 % of the time, 1 % false "
        f"alarms), and by how\nmany standard deviations it then moves a parameter\n"
        f"{causes_table(outlook)}"
    )
    for remark in causes_remarks(outlook):
        terminal.say(f"  {remark}")


def _plain(
    prediction: Prediction, criterion: Criterion, outlooks: dict[int, Outlook]
) -> dict[str, Any]:
    seen, outlook = prediction.observability, outlooks.get(id(prediction))
    return {
        "name": prediction.program.name,
        "duration_s": prediction.duration_s,
        "moves": prediction.moves,
        "std": dict(prediction.std),
        "gain_std": np.asarray(prediction.gain_std).tolist(),
        "time_offset_by_motion_std_s": prediction.motion_offset_std_s,
        "cost": cost(prediction.decision, criterion),
        "observability": {
            "rank": seen.rank,
            "of": seen.of,
            "condition": seen.condition,
            "unobservable": list(seen.unobservable),
            "reasons": list(seen.reasons),
        },
        "causes": causes_plain(outlook) if outlook else None,
    }
