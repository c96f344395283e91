"""Motion programs by name: shipped ones, backwards, or several one after the other.

What to use when: `program_text` for a shipped program, by its name, or by its name and
"-backwards" for checks of what must not depend on the order of things, or by several names
joined by "+" for a long session, or by the path of a YAML file. Programs that only tests use stand
beside this file.
"""

from pathlib import Path
from typing import Any

from gyrorig_protocol.documents import dump_yaml, parse_yaml

PROGRAMS = Path(__file__).resolve().parents[3] / "config" / "programs"
BACKWARDS = "-backwards"
Step = dict[str, dict[str, Any]]


def program_text(name: str) -> bytes:
    """Return a program as a file holds it."""
    if name.endswith(".yaml"):
        return Path(name).read_bytes()
    if "+" in name:
        documents = [parse_yaml(program_text(part), part) for part in name.split("+")]
        steps = [step for document in documents for step in document["steps"]]
        return dump_yaml({**documents[0], "steps": steps}).encode()
    shipped = name.removesuffix(BACKWARDS)
    test_program = Path(__file__).with_name(f"{shipped}.yaml")
    text = (test_program if test_program.exists() else PROGRAMS / test_program.name).read_bytes()
    if shipped == name:
        return text
    document = parse_yaml(text, name)
    return dump_yaml(
        {**document, "name": name, "steps": reversed_steps(document["steps"])}
    ).encode()


def reversed_steps(steps: list[Step]) -> list[Step]:
    """Return steps in the opposite order, each move to where its axes came from.

    Raises:
        ValueError: the steps do not end where they begin, at zero, or do more than move and rest.
    """
    at = {"pan_deg": 0.0, "tilt_deg": 0.0}
    reversed_list: list[Step] = []
    for step in steps:
        if set(step) == {"rest"}:
            reversed_list.append(step)
            continue
        if set(step) != {"move"}:
            raise ValueError(f"{set(step)} has no opposite")
        back = {key: at.get(key, value) for key, value in step["move"].items()}
        at |= {key: value for key, value in step["move"].items() if key in at}
        reversed_list.append({"move": back})
    if any(at.values()):
        raise ValueError(f"it ends at {at}, not where it began")
    return reversed_list[::-1]
