"""Write the manual's pages `share/man/man1/gyrorig.1` and `gyrorigd.1`: `python -m docs.man`.

The script makes the pages from the help of the commands. Run it again after a change of a command.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from docs.commands import EXIT_CODES, PROGRAMS, CommandDescription, describe_commands

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "share" / "man" / "man1"
SUMMARIES = {
    "gyrorig": "calibrate gyroscopes from pan-tilt recordings",
    "gyrorigd": "drive a calibration rig and record it, or emulate one",
}
OTHER_PROGRAM = {"gyrorig": "gyrorigd", "gyrorigd": "gyrorig"}


def make_page(program: str) -> str:
    """Return the page of a program in the man macros of groff."""
    lines = [
        f'.\\" Written by docs/man.py out of the help of {program}.',
        f'.TH {program.upper()} 1 "" "Gyrorig" "User Commands"',
        ".SH NAME",
        f"{program} \\- {_escape(SUMMARIES[program])}",
        ".SH SYNOPSIS",
        f".B {program}",
        "[\\-\\-version] [\\-\\-help]",
        ".I COMMAND",
        "[\\fIOPTIONS\\fR] [\\fIARGUMENTS\\fR]",
        ".SH DESCRIPTION",
        _escape(" ".join((PROGRAMS[program].help or "").split("Example")[0].split())),
        ".SH COMMANDS",
    ]
    for command in describe_commands(program):
        lines += _format_command(command)
    lines.append(".SH EXIT STATUS")
    for code, meaning in EXIT_CODES:
        lines += [".TP", f".B {code}", _escape(meaning)]
    lines += [
        ".SH COMPLETION",
        "For bash, zsh and fish, under share/ of where it is installed; or in a running shell:",
        ".PP",
        ".nf",
        _escape(f'eval "$(_{program.upper()}_COMPLETE=bash_source {program})"'),
        ".fi",
        ".SH SEE ALSO",
        f".BR {OTHER_PROGRAM[program]} (1)",
    ]
    return "\n".join(lines) + "\n"


def _format_command(command: CommandDescription) -> Iterator[str]:
    yield f'.SS "{_escape(command.usage)}"'
    for number, paragraph in enumerate(command.paragraphs):
        if number:
            yield ".PP"
        yield _escape(paragraph)
    for option, text in command.options:
        yield ".TP"
        yield f".B {_escape(option)}"
        yield _escape(text) or "\\&"
    if command.examples:
        yield ".PP"
        yield "Example:"
        yield ".PP"
        yield ".nf"
        for example in command.examples:
            yield f"    {_escape(example)}"
        yield ".fi"


def _escape(text: str) -> str:
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"^([.'])", r"\\&\1", text)


def main() -> None:
    """Write both pages."""
    PAGES.mkdir(parents=True, exist_ok=True)
    for program in PROGRAMS:
        path = PAGES / f"{program}.1"
        path.write_text(make_page(program), encoding="utf-8")
        print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
