"""A file that was given by mistake is recognised by its first bytes."""

import io
from pathlib import Path

import numpy as np
import pytest

from gyrorig_protocol.documents import parse_result_document, parse_yaml
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.file_kinds import (
    HEAD_BYTES,
    describe_file_kind,
    describe_schema,
    explain_wrong_schema,
)
from gyrorig_protocol.profile import parse_profile
from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_protocol.recording.reader import read_recording


def npz() -> bytes:
    file = io.BytesIO()
    np.savez(file, gyro=np.zeros(3))
    return file.getvalue()


@pytest.mark.parametrize(
    ("head", "kind"),
    [
        (b"", "an empty file"),
        (b"\x89MCAP0\r\n\x01", "a recording (MCAP)"),
        (b'schema: "gyrorig/calibration/1"\n', "a calibration"),
        (b"# a comment\n\nschema: gyrorig/findings/1\n", "a findings document"),
        (b"rig: bench\nschema: 'gyrorig/rig/1' # the rig\n", "a rig configuration"),
        (b"schema: gyrorig/program/2\n", "a motion program"),
        (b'{"x": 1,\n "schema": "gyrorig/import/1"}', "an import map"),
        (b"\xef\xbb\xbfschema: gyrorig/sensor/1\n", "a sensor profile"),
        (b"schema: gyrorig/job/1\n", "a job of the daemon"),
        (b"schema: gyrorig/other/1\n", "a document with the schema 'gyrorig/other/1'"),
        (b"rig: bench\nptu: {port: emulated}\n", "a document without a schema"),
        (b"- 1\n- 2\n", "a document without a schema"),
        (b"\n  <!DOCTYPE html>\n<html>", "a web page (HTML)"),
        (b'<!doctype html><meta http-equiv="Content-Security-Policy">', "a report page (HTML)"),
        (b"\xff\xfet\0,\0x\0\n\0", "a text in UTF-16"),
        (
            b"version https://git-lfs.github.com/spec/v1\n",
            "a pointer of Git LFS instead of the file itself",
        ),
        (b"$GPGGA,123519,4807.038,N\n", "a GPS log (NMEA)"),
        (b"\x1f\x8b\x08\0", "a compressed file (gzip)"),
        (b"time,x,y,z\n0.0,1,2,3\n", "a table (CSV)"),
        (b"# phone\n0;1;2\n1;2;3\n", "a table (CSV)"),
        (b"hello, world\nthis is text\n", "a text file"),
        (b"PK\x03\x04 word/document.xml", "a ZIP archive"),
        (b"\x7fELF\x02\x01\0\0", "a binary file"),
        (b"\xff\xfe\xff\xfe", "a binary file"),
    ],
)
def test_kind_of_a_file(head: bytes, kind: str) -> None:
    assert describe_file_kind(head) == kind


def test_kind_of_a_numpy_archive() -> None:
    assert describe_file_kind(npz()) == "a NumPy archive (npz)"


def test_only_the_head_is_looked_at() -> None:
    assert describe_file_kind(b"x" * HEAD_BYTES + b"\0") == "a text file"
    cut = ("é" * HEAD_BYTES).encode()[1:]  # begins and ends inside a character
    assert describe_file_kind(cut[1:]) == "a text file"


@pytest.mark.parametrize("schema", [None, 3, "", "gyrorig/rig", "gyrorig/none/1", "x/rig/1"])
def test_unknown_schema_has_no_kind(schema: object) -> None:
    assert describe_schema(schema) is None


def test_right_schema_needs_no_explanation() -> None:
    assert explain_wrong_schema("a.yaml", "gyrorig/rig/1", "gyrorig/rig/1") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "schema: gyrorig/rig/1\nrig: bench\n",
            "rig.yaml is a rig configuration. A motion program is expected here. "
            "Give a file with schema gyrorig/program/1.",
        ),
        (
            "schema: gyrorig/program/2\n",
            "rig.yaml has the schema gyrorig/program/2, which this version cannot read. "
            "Give a file with schema gyrorig/program/1.",
        ),
        (
            "schema: mine\nname: x\nsteps: []\n",
            "rig.yaml is not a motion program, because its schema is 'mine'. "
            "Give a file with schema gyrorig/program/1.",
        ),
    ],
)
def test_swapped_documents_are_named(text: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_program(text, "rig.yaml")
    assert str(caught.value) == message


def test_a_document_without_the_key_schema_may_be_a_program() -> None:
    text = "name: x\nsteps: [{rest: {seconds: 1.0}}]\n"
    assert parse_program(text, "p.yaml").name == "x"


def test_a_result_document_needs_the_key_schema() -> None:
    with pytest.raises(InputError) as caught:
        parse_result_document("name: x", "cal.yaml", MotionProgram, "gyrorig/calibration/1")
    assert str(caught.value) == (
        "cal.yaml is not a calibration, because it has no key schema. "
        "Give a file with schema gyrorig/calibration/1."
    )


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\x89MCAP0\r\n" + bytes(100), "a recording (MCAP)"),
        (npz(), "a NumPy archive (npz)"),
        (
            b'<!doctype html><meta http-equiv="Content-Security-Policy"><title>Report</title>',
            "a report page (HTML)",
        ),
        (b"time,x,y\n0,1,2\n" * 500, "a table (CSV)"),
    ],
)
@pytest.mark.parametrize("size", [0, 5_000_000])
def test_other_files_are_named_where_yaml_is_expected(data: bytes, kind: str, size: int) -> None:
    with pytest.raises(InputError) as caught:
        parse_yaml(data + bytes(size), "x.yaml", InputError)
    assert str(caught.value) == (
        f"x.yaml is {kind}. A document (YAML) is expected here. Give the right file."
    )


def test_other_text_is_named_where_a_profile_is_expected() -> None:
    with pytest.raises(UsageError) as caught:
        parse_profile(b"\x89MCAP0\r\n", "BMI088.yaml")
    assert str(caught.value) == (
        "BMI088.yaml is a recording (MCAP). A sensor profile is expected here. "
        "Give a file with schema gyrorig/sensor/1."
    )


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            b"schema: gyrorig/calibration/1\n",
            "is a calibration, not a recording. Give the file of a recording (.mcap).",
        ),
        (
            b"t,x\n0,1\n",
            "is a table (CSV), not a recording. Convert it with `gyrorig import`.",
        ),
    ],
)
def test_other_files_are_named_where_a_recording_is_expected(
    tmp_path: Path, data: bytes, message: str
) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert str(caught.value) == f"{path} {message}"
