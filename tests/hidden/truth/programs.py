"""Motion programs by name: shipped programs, reversed programs, or several in sequence.

What to use when: `read_program_text` for a program. Its name can be that of a shipped program, or
the path of a YAML file. The suffix "-backwards" reverses the moves, for tests that must not depend
on their order. Several names with "+" between them make a long session. Programs for tests are next
to this file.
"""

from pathlib import Path
from typing import Any

from gyrorig_protocol.documents import dump_yaml, parse_yaml

PROGRAMS = Path(__file__).resolve().parents[3] / "config" / "programs"
BACKWARDS = "-backwards"
Step = dict[str, dict[str, Any]]


def read_program_text(name: str) -> bytes:
    """Return the text of a program."""
    if name.endswith(".yaml"):
        return Path(name).read_bytes()
    if "+" in name:
        documents = [parse_yaml(read_program_text(part), part) for part in name.split("+")]
        steps = [step for document in documents for step in document["steps"]]
        return dump_yaml({**documents[0], "steps": steps}).encode()
    shipped = name.removesuffix(BACKWARDS)
    test_program = Path(__file__).with_name(f"{shipped}.yaml")
    text = (test_program if test_program.exists() else PROGRAMS / test_program.name).read_bytes()
    if shipped == name:
        return text
    document = parse_yaml(text, name)
    return dump_yaml({**document, "name": name, "steps": reverse_steps(document["steps"])}).encode()


def reverse_steps(steps: list[Step]) -> list[Step]:
    """Return the steps in the opposite order; each move goes back to the previous angles.

    Raises:
        ValueError: the steps do not end at zero, or a step is not a move or a rest.
    """
    at = {"pan_deg": 0.0, "tilt_deg": 0.0}
    reversed_list: list[Step] = []
    for step in steps:
        if set(step) == {"rest"}:
            reversed_list.append(step)
            continue
        if set(step) != {"move"}:
            raise ValueError(f"cannot reverse {set(step)}")
        reversed_move = {key: at.get(key, value) for key, value in step["move"].items()}
        at |= {key: value for key, value in step["move"].items() if key in at}
        reversed_list.append({"move": reversed_move})
    if any(at.values()):
        raise ValueError(f"the program ends at {at}, not at zero")
    return reversed_list[::-1]
