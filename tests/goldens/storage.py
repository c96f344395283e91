"""Where the golden results are stored, and how: one text file for each case.

What to use when: `load` and `save` by a case's name. The text is JSON with one short value for
each line, so that a change of the golden set can be read in a diff.
"""

import json
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parent / "results"
_WIDTH = 110


def _text(value: Any, indent: str = "") -> str:
    """Return JSON that breaks a line only where a value is longer than a line."""
    whole = json.dumps(value, ensure_ascii=False)
    is_numbers = isinstance(value, list) and all(isinstance(v, float | int) for v in value)
    if len(whole) <= _WIDTH or is_numbers or not isinstance(value, dict | list) or not value:
        return whole
    if isinstance(value, dict):
        parts = [f"{json.dumps(key)}: {_text(part, indent + ' ')}" for key, part in value.items()]
    else:
        parts = [_text(part, indent + " ") for part in value]
    begin, end = "{}" if isinstance(value, dict) else "[]"
    inner = f",\n{indent} ".join(parts)
    return f"{begin}\n{indent} {inner}\n{indent}{end}"


def path_of(name: str) -> Path:
    """Return the file of a case's golden result."""
    return RESULTS / f"{name}.json"


def load(name: str) -> Any:
    """Return a case's golden result, None when there is none."""
    path = path_of(name)
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def save(name: str, result: Any) -> None:
    """Store a case's golden result."""
    RESULTS.mkdir(exist_ok=True)
    path_of(name).write_text(_text(result) + "\n", encoding="utf-8")


def as_stored(result: Any) -> Any:
    """Return a result as it is after it was stored and loaded."""
    return json.loads(json.dumps(result))


def remove_others(names: set[str]) -> None:
    """Remove golden results that no case has."""
    for path in RESULTS.glob("*.json"):
        if path.stem not in names:
            path.unlink()
