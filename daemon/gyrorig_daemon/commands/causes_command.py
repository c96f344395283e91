"""`gyrorigd causes`: the imperfections that an emulated rig can have."""

import json

import click


@click.command("causes", short_help="List the causes that --hide accepts.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def causes_command(as_json: bool) -> None:
    r"""List the imperfections that an emulated rig can have: places, units, random sizes.

    \b
    Example:
      gyrorigd causes
    """
    from gyrorig_daemon.emulator.injection import CAUSES  # noqa: PLC0415 - not for the other commands

    if as_json:
        click.echo(json.dumps({"causes": [cause.to_document() for cause in CAUSES.values()]}))
        return
    for cause in CAUSES.values():
        places = f"@{','.join(cause.components)}" if cause.components else ""
        sizes = ", ".join(f"{size:g}" for size in cause.allowed_sizes)
        sizes = sizes or f"{cause.sampled_min:g} to {cause.sampled_max:g}"
        unit = "" if cause.unit == "1" else f" {cause.unit}"
        click.echo(f"{cause.name}{places}: {cause.size_meaning}; random size: {sizes}{unit}")
