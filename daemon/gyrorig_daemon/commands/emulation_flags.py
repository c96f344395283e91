"""The options of `record` and `emulate` that describe an emulated rig."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from gyrorig_daemon.session.emulation_options import EmulationOptions

YAML_FILE = click.Path(path_type=Path, dir_okay=False)
_HIDE = (
    "Add this cause to the emulated rig. PLACE is an axis or a board, and SIZE is in the "
    "unit that `gyrorigd causes` lists. `random` chooses causes and keeps them secret. Can "
    "be repeated."
)

CommandFunction = Callable[..., None]


def emulation_flags(command: CommandFunction) -> CommandFunction:
    """Add the options that describe an emulated rig (decorator)."""
    for option in reversed(
        (
            click.option(
                "--seed",
                type=click.IntRange(min=0),
                help=(
                    "With an emulated rig: random seed of the rig's errors and of the noise.  "
                    "[default: `seed` under `emulator` in the rig file]"
                ),
            ),
            click.option(
                "--session-seed",
                type=click.IntRange(min=0),
                help=(
                    "With an emulated rig: random seed of the noise of this session. Sessions of "
                    "one rig with different seeds have independent noise.  [default: the noise "
                    "follows from --seed]"
                ),
            ),
            click.option(
                "--draw",
                type=click.IntRange(min=0),
                default=0,
                show_default=True,
                metavar="NUMBER",
                help="With a twin: draw the parameters from their posterior. The same number gives "
                "the same parameters; 0 gives the best values.",
            ),
            click.option(
                "--truth",
                type=YAML_FILE,
                help="With an emulated rig: write the true parameters to this file, as JSON if the "
                "name ends in .json, otherwise as YAML.",
            ),
            click.option("--hide", multiple=True, metavar="CAUSE[@PLACE][:SIZE]", help=_HIDE),
            click.option(
                "--noise-free", is_flag=True, help="With an emulated rig: sensors without noise."
            ),
            click.option(
                "--soak",
                type=click.FloatRange(-60.0, 60.0),
                default=0.0,
                show_default=True,
                metavar="KELVIN",
                help="With an emulated rig: warm the room by so many kelvin and cool it again.",
            ),
        )
    ):
        command = option(command)
    return command


def emulation_options(options: dict[str, Any], session_s: tuple[float, float]) -> EmulationOptions:
    """Return the options of the command line as one object."""
    return EmulationOptions(
        seed=options["seed"],
        session_seed=options["session_seed"],
        draw=options["draw"],
        is_replay=options.get("replay_path") is not None,
        twin_recording=options.get("twin_recording"),
        truth=options["truth"],
        rates=options.get("rates"),
        with_plain_rates=not options.get("rates_of_session", False),
        hide=options["hide"],
        noise_free=options["noise_free"],
        soak_k=options["soak"],
        session_s=session_s,
    )


def print_commitment(sha256: str) -> None:
    """Print the hash of the hidden parameters, which are published at the end."""
    click.echo(
        f"The hidden parameters are secret until the end. Their SHA-256 is {sha256}", err=True
    )
