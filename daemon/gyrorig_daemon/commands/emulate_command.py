"""`gyrorigd emulate`: the emulated devices of a rig on pseudo-terminals, for any program."""

import json
import os
import signal
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from gyrorig_daemon.commands.emulation_flags import (
    YAML_FILE,
    emulation_flags,
    emulation_options,
    print_commitment,
)
from gyrorig_daemon.config import load_rig
from gyrorig_daemon.session.record_modes import serve_emulated_rig
from gyrorig_protocol.errors import UsageError


@click.command("emulate", short_help="Run an emulated rig on pseudo-terminals.")
@click.option("--config", "config_path", type=YAML_FILE, required=True, help="The rig file (YAML).")
@emulation_flags
@click.option(
    "--from",
    "begin_s",
    type=click.FloatRange(0.0, 1e6),
    default=0.0,
    show_default=True,
    metavar="SECONDS",
    help="Start of the session, in seconds after power-up.",
)
@click.option(
    "--until",
    "end_s",
    type=click.FloatRange(1.0, 1e6),
    default=60.0,
    show_default=True,
    metavar="SECONDS",
    help="End of the session, in seconds after power-up. Single events happen between the two.",
)
@click.option(
    "--links",
    type=click.Path(path_type=Path, file_okay=False),
    help="A folder for symbolic links with the names of the ports.  [default: none]",
)
@click.option(
    "--twin-recording", hidden=True, help="Only with a twin: the recording whose events happen."
)
@click.option("--json", "as_json", is_flag=True, help="Print the ports as one JSON object.")
@click.option("--until-eof", is_flag=True, help="Stop at the end of standard input.")
def emulate_command(**options: Any) -> None:
    r"""Open the emulated unit and boards on pseudo-terminals and print their paths.

    Any program can connect to them. Only the ports that are `emulated` in the configuration
    are opened. The command runs until it is stopped.

    \b
    Example:
      gyrorigd emulate --config config/rig.yaml
    """
    config = load_rig(options["config_path"])
    begin_s, end_s = options["begin_s"], options["end_s"]
    if end_s <= begin_s:
        raise UsageError(
            f"the end time --until {end_s:g} s is not later than the start time --from "
            f"{begin_s:g} s",
            "give a later time with --until, or an earlier time with --from",
        )
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: stop.set())
    if options["until_eof"]:
        threading.Thread(target=_wait_for_eof, args=(stop,), daemon=True).start()

    def announce(ports: Mapping[str, str], commitment: str | None, power_up_ns: int) -> None:
        if options["as_json"]:
            document: dict[str, Any] = {"ports": dict(ports), "power_up_raw_ns": power_up_ns}
            click.echo(
                json.dumps(document if commitment is None else document | {"seal": commitment})
            )
        else:
            for name, path in ports.items():
                click.echo(f"{name}\t{path}")
            if commitment is not None:
                print_commitment(commitment)
        sys.stdout.flush()

    emulation = emulation_options(options, (begin_s, end_s))
    serve_emulated_rig(config, emulation, announce, stop, options["links"])


def _wait_for_eof(stop: threading.Event) -> None:
    # Not through sys.stdin: a thread that holds its lock breaks the interpreter's exit.
    with suppress(OSError):
        while os.read(0, 4096):
            pass
    stop.set()
