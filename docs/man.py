"""Write the manual's pages `share/man/man1/gyrorig.1` and `gyrorigd.1`: `python -m docs.man`.

They are made of the commands' own help; after a command was changed, run this again.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from docs.commands import EXIT_CODES, PROGRAMS, CommandDescription, described

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "share" / "man" / "man1"
ABOUT = {
    "gyrorig": "calibrate gyroscopes from pan-tilt recordings",
    "gyrorigd": "drive a calibration rig and record it, or emulate one",
}
SEE = {"gyrorig": "gyrorigd", "gyrorigd": "gyrorig"}


def page(program: str) -> str:
    """Return a program's page, in the language of groff's man macros."""
    lines = [
        f'.\\" Written by docs/man.py out of the help of {program}.',
        f'.TH {program.upper()} 1 "" "Gyrorig" "User Commands"',
        ".SH NAME",
        f"{program} \\- {_escaped(ABOUT[program])}",
        ".SH SYNOPSIS",
        f".B {program}",
        "[\\-\\-version] [\\-\\-help]",
        ".I COMMAND",
        "[\\fIOPTIONS\\fR] [\\fIARGUMENTS\\fR]",
        ".SH DESCRIPTION",
        _escaped(" ".join((PROGRAMS[program].help or "").split("Example")[0].split())),
        ".SH COMMANDS",
    ]
    for command in described(program):
        lines += _command(command)
    lines.append(".SH EXIT STATUS")
    for code, meaning in EXIT_CODES:
        lines += [".TP", f".B {code}", _escaped(meaning)]
    lines += [
        ".SH COMPLETION",
        "For bash, zsh and fish, under share/ of where it is installed; or in a running shell:",
        ".PP",
        ".nf",
        _escaped(f'eval "$(_{program.upper()}_COMPLETE=bash_source {program})"'),
        ".fi",
        ".SH SEE ALSO",
        f".BR {SEE[program]} (1)",
    ]
    return "\n".join(lines) + "\n"


def _command(command: CommandDescription) -> Iterator[str]:
    yield f'.SS "{_escaped(command.usage)}"'
    for number, paragraph in enumerate(command.paragraphs):
        if number:
            yield ".PP"
        yield _escaped(paragraph)
    for option, text in command.options:
        yield ".TP"
        yield f".B {_escaped(option)}"
        yield _escaped(text) or "\\&"
    if command.examples:
        yield ".PP"
        yield "Example:"
        yield ".PP"
        yield ".nf"
        for example in command.examples:
            yield f"    {_escaped(example)}"
        yield ".fi"


def _escaped(text: str) -> str:
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"^([.'])", r"\\&\1", text)


def main() -> None:
    """Write both pages."""
    PAGES.mkdir(parents=True, exist_ok=True)
    for program in PROGRAMS:
        path = PAGES / f"{program}.1"
        path.write_text(page(program), encoding="utf-8")
        print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
