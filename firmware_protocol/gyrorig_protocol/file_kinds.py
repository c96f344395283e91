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
WEB_PAGE = "a web page (HTML)"
EXCEL_WORKBOOK = "an Excel workbook (xlsx)"
UTF16_TEXT = "a text in UTF-16"
LFS_POINTER = "a pointer of Git LFS instead of the file itself"
GPS_LOG = "a GPS log (NMEA)"
TAR_ARCHIVE = "a tar archive"
DAMAGED_ZIP = "a damaged or incomplete ZIP archive"
# first bytes -> kind
_SIGNATURES = {
    b"\x89MCAP0\r\n": RECORDING,
    b"\xff\xd8\xff": "a picture (JPEG)",
    b"\x89PNG\r\n": "a picture (PNG)",
    b"GIF8": "a picture (GIF)",
    b"%PDF-": "a PDF document",
    b"\x1f\x8b": "a compressed file (gzip)",
    b"BZh": "a compressed file (bzip2)",
    b"\xfd7zXZ\0": "a compressed file (xz)",
    b"\x28\xb5\x2f\xfd": "a compressed file (zstd)",
    b"7z\xbc\xaf\x27\x1c": "a 7-Zip archive",
    b"Rar!": "a RAR archive",
    b"\x89HDF\r\n\x1a\n": "an HDF5 file",
    b"SQLite format 3\0": "a SQLite database",
    b"#ROSBAG V": "a ROS 1 bag",
    b"PAR1": "a Parquet table",
    b"MATLAB 5.0": "a MATLAB file",
    b"\x55\x4c\x6f\x67\x01\x12\x35": "a PX4 log (ULog)",
    b"\xa3\x95\x80": "an ArduPilot log (DataFlash)",
    b"\xd4\xc3\xb2\xa1": "a network capture (pcap)",
    b"\xa1\xb2\xc3\xd4": "a network capture (pcap)",
    b"\x0a\x0d\x0d\x0a": "a network capture (pcapng)",
    b"\xd0\xcf\x11\xe0": "an old Office document, for example an Excel workbook (xls)",
    b"RIFF": "a sound or a video (RIFF)",
}
# `gyrorig import` reads these
IMPORTABLE = frozenset(
    {CSV_TABLE, NUMPY_ARCHIVE, ZIP_ARCHIVE, "a ROS 1 bag", "a Parquet table", "a MATLAB file"}
    | {"a PX4 log (ULog)", "an ArduPilot log (DataFlash)", "a SQLite database", "an HDF5 file"}
)
_REPORT_MARK = "content-security-policy"  # our reports allow no scripts
_UNPACK = "unpack it, and give the file or folder inside"
_REMEDIES = {
    **{kind: _UNPACK for kind in _SIGNATURES.values() if "compressed" in kind or "archive" in kind},
    TAR_ARCHIVE: _UNPACK,
    ZIP_ARCHIVE: _UNPACK,
    WEB_PAGE: "download the file again, because the server sent a page instead of the file",
    EXCEL_WORKBOOK: "save the sheet as a table (CSV), and import it with a column map",
    UTF16_TEXT: "save the text as UTF-8",
    LFS_POINTER: "run `git lfs pull` in the checkout, and give the file again",
    GPS_LOG: "give the log of a gyroscope",
    EMPTY_FILE: "copy the file again from its source",
    DAMAGED_ZIP: "copy the file again from its source",
}
NEVER_YAML = frozenset(
    {REPORT_PAGE, NUMPY_ARCHIVE, ZIP_ARCHIVE, WEB_PAGE, EXCEL_WORKBOOK, TAR_ARCHIVE}
) | frozenset(_SIGNATURES.values())

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
_NMEA_LINE = re.compile(r"\s*[$!](?:G[A-Z]|P)[A-Z]{3,4},")
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
    if not head:
        return EMPTY_FILE
    binary = _describe_binary(head)
    if binary is not None:
        return binary
    text = head.decode("utf-8", errors="replace").removeprefix("\ufeff")
    start = text.lstrip().casefold()
    if start.startswith(("<!doctype html", "<html")):
        return REPORT_PAGE if _REPORT_MARK in start else WEB_PAGE
    if b"\0" in head or text.count("\ufffd") > 1:  # one: a character that was cut at the end
        return "a binary file"
    return _describe_text(text)


def describe_remedy(kind: str) -> str | None:
    """Return what to do with a file of this kind that cannot be read, None if nothing is known."""
    return _REMEDIES.get(kind)


def _describe_binary(head: bytes) -> str | None:
    """Return the kind by the first bytes, None if they are of no known kind."""
    for signature, kind in _SIGNATURES.items():
        if head.startswith(signature):
            return kind
    if head.startswith(b"PK"):
        if b"[Content_Types].xml" in head or b"xl/" in head:
            return EXCEL_WORKBOOK
        return NUMPY_ARCHIVE if b".npy" in head else ZIP_ARCHIVE
    if head[257:262] == b"ustar":
        return TAR_ARCHIVE
    if head[:2] in (b"\xff\xfe", b"\xfe\xff") and 4 * head.count(0) > len(head):
        return UTF16_TEXT
    return "a video (MP4)" if head[4:8] == b"ftyp" else None


def _describe_text(text: str) -> str:
    if text.startswith("version https://git-lfs."):
        return LFS_POINTER
    if _NMEA_LINE.match(text):
        return GPS_LOG
    if text.startswith("<?xml"):
        return "an XML document"
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
