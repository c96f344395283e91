"""File kinds: recognise a file by its first bytes, to name what was given by mistake.

What to use when: `describe_file_kind` when a file cannot be read as what was asked for;
`describe_schema` for the `schema` of a YAML document; `explain_wrong_schema` and
`explain_wrong_kind` for the text of the error. Nothing here decides how a file is read.
"""

import re

HEAD_BYTES = 4096  # as much of a file as is looked at

RECORDING = "a recording (MCAP)"
REPORT_PAGE = "a report page (HTML)"
NUMPY_ARCHIVE = "a NumPy archive (npz)"
CSV_TABLE = "a table (CSV)"
EMPTY_FILE = "an empty file"
ZIP_ARCHIVE = "a ZIP archive"
NEVER_YAML = frozenset({RECORDING, REPORT_PAGE, NUMPY_ARCHIVE, ZIP_ARCHIVE})

_SCHEMA_KINDS = {
    "calibration": "a calibration",
    "findings": "a findings document",
    "import": "an import map",
    "job": "a job of the daemon",
    "program": "a motion program",
    "rig": "a rig configuration",
    "sensor": "a sensor profile",
    "uncertainty": "uncertainty settings",
    "unit": "a posterior of a unit",
}
_SCHEMA = re.compile(r"gyrorig/([a-z-]{1,20})/\d{1,3}")
_SCHEMA_LINE = re.compile(r"""^\s*["']?schema["']?\s*:\s*["']?([^"'\s,#]+)""", re.MULTILINE)
_YAML_LINE = re.compile(r"""[\w"'][\w .-]*["']?\s*:(?:\s|$)|- |---|[{\[]""")


def describe_schema(schema: object) -> str | None:
    """Return the kind of document that `schema` names, "a calibration"; None if unknown."""
    match = _SCHEMA.fullmatch(schema) if isinstance(schema, str) else None
    return None if match is None else _SCHEMA_KINDS.get(match[1])


def describe_file_kind(head: bytes) -> str:
    """Return the kind of a file with its article: "a recording (MCAP)", "a calibration".

    Args:
        head: the beginning of the file; the first `HEAD_BYTES` are looked at.
    """
    head = head[:HEAD_BYTES]
    text = head.decode("utf-8", errors="replace").removeprefix("\ufeff")
    start = text.lstrip().casefold()
    if not head:
        kind = EMPTY_FILE
    elif head.startswith(b"\x89MCAP0\r\n"):
        kind = RECORDING
    elif head.startswith(b"PK"):
        kind = NUMPY_ARCHIVE if b".npy" in head else ZIP_ARCHIVE
    elif start.startswith(("<!doctype html", "<html")):
        kind = REPORT_PAGE
    elif b"\0" in head or text.count("\ufffd") > 1:  # one: a character that was cut at the end
        kind = "a binary file"
    else:
        kind = _describe_text(text)
    return kind


def _describe_text(text: str) -> str:
    schema = _SCHEMA_LINE.search(text)
    if schema is not None:
        return describe_schema(schema[1]) or f"a document with the schema {schema[1][:40]!r}"
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if lines and _YAML_LINE.match(lines[0].lstrip()):
        return "a document without a schema"
    counts = {max(line.count(mark) for mark in ",;\t") for line in lines[:2]}
    return CSV_TABLE if len(counts) == 1 and counts.pop() > 0 else "a text file"


def explain_wrong_schema(name: str, schema: object, expected: str) -> tuple[str, str] | None:
    """Return the problem and the remedy if `schema` is not the one expected, else None.

    Args:
        name: the document, usually its file name.
        schema: the value of its key `schema`, None if it has no such key.
        expected: the only schema that can be read here.
    """
    if schema == expected:
        return None
    expected_kind = describe_schema(expected) or "another document"
    found_kind = describe_schema(schema)
    if found_kind == expected_kind:
        problem = f"{name} has the schema {schema}, which this version cannot read"
    elif found_kind is not None:
        problem = f"{name} is {found_kind}. {expected_kind.capitalize()} is expected here"
    elif schema is None:
        problem = f"{name} is not {expected_kind}, because it has no key schema"
    else:
        problem = f"{name} is not {expected_kind}, because its schema is {str(schema)[:40]!r}"
    return problem, f"give a file with schema {expected}"


def explain_wrong_kind(name: str, kind: str, schema: str = "") -> tuple[str, str]:
    """Return the problem and the remedy for a file of another kind.

    Args:
        name: the document, usually its file name.
        kind: the kind of the file, from `describe_file_kind`.
        schema: the only schema that can be read here; "" for any document.
    """
    expected = describe_schema(schema) or "a document (YAML)"
    remedy = f"give a file with schema {schema}" if schema else "give the right file"
    return (
        f"{name} is {kind}. {expected[0].upper()}{expected[1:]} is expected here",
        remedy,
    )
