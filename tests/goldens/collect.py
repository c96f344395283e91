"""Turn what a command left, files and output, into a result that can be stored and compared.

What to use when: `result_of` after a command has ended. Documents are kept whole; of recordings,
tables and figures only counts, digests and sums are kept, so that the golden set stays small.
"""

import csv
import hashlib
import json
import math
import re
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader
from tests.goldens.fields import masked, without_varying_parts

NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_C_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_C_TOKEN = re.compile(r"[A-Za-z_]\w*|[\d.][\w.]*(?:(?<=[eE])[-+]\d+\w*)?|\S")
_SVG = re.compile(r"<svg.*?</svg>", re.DOTALL)
_SVG_TEXT = re.compile(r"<(text|title|desc|style)\b.*?</\1>", re.DOTALL)
_IMU_DOUBLES = 37  # sensor_msgs/msg/Imu ends with so many: orientation, rates, covariances
_EXACT_TOPICS = re.compile(r"/imu_raw$|/ptu/|/clock$|/reference/")
Result = dict[str, Any]


def _sums(values: Iterable[float]) -> Result:
    """Return count, sum, sum of absolute values and last of numbers."""
    numbers = [value for value in values if math.isfinite(value)]
    total, size = math.fsum(numbers), math.fsum(map(abs, numbers))
    last = numbers[-1] if numbers else None
    return {"count": len(numbers), "sum": total, "absolute": size, "last": last}


def _document(path: Path) -> Any:
    text = path.read_text(encoding="utf-8")
    return json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)


def _c_header(path: Path) -> Result:
    text = _C_COMMENT.sub(" ", path.read_text(encoding="utf-8"))
    return {"tokens": " ".join(_C_TOKEN.findall(text))}


def _parameter_file(path: Path) -> Result:
    lines = [line.partition("#")[0] for line in path.read_text(encoding="utf-8").splitlines()]
    return {"tokens": " ".join(" ".join(lines).replace(",", " , ").split())}


def _table(path: Path) -> Result:
    with path.open(encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    columns = zip(*rows, strict=True)
    return {name: _sums(map(float, column)) for name, column in zip(header, columns, strict=True)}


def _figures(path: Path) -> Result:
    """Return sums of the numbers in a file's figures, their words left out."""
    figures = _SVG.findall(path.read_text(encoding="utf-8"))
    text = " ".join(_SVG_TEXT.sub(" ", figure) for figure in figures)
    return {"figures": len(figures), **_sums(map(float, NUMBER.findall(text)))}


def _recording(path: Path) -> Result:
    """Return each topic's count, and a digest where its messages are numbers alone.

    The digest covers the times of each message, its sequence number and its bytes.
    """
    digests: dict[str, Any] = {}
    counts: dict[str, int] = {}
    imu: dict[str, list[float]] = {}
    names: list[str] = []
    damage = ""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        try:
            names = [item.name for item in reader.iter_metadata()]
            for _, channel, message in reader.iter_messages(log_time_order=False):
                topic = channel.topic
                counts[topic] = counts.get(topic, 0) + 1
                if _EXACT_TOPICS.search(topic):
                    digest = digests.setdefault(topic, hashlib.sha256())
                    times = message.log_time, message.publish_time, message.sequence
                    digest.update(struct.pack("<QQI", *times) + message.data)
                elif topic.endswith("/imu"):
                    doubles = struct.unpack(f"<{_IMU_DOUBLES}d", message.data[-8 * _IMU_DOUBLES :])
                    imu.setdefault(topic, []).extend(doubles)
        except (McapError, struct.error) as fault:
            damage = type(fault).__name__
    topics: dict[str, Any] = {}
    for topic, count in sorted(counts.items()):
        topics[topic] = {"count": count}
        if topic in digests:
            topics[topic]["digest"] = digests[topic].hexdigest()
        if topic in imu:
            topics[topic]["doubles"] = _sums(imu[topic])
    return {"topics": topics, "metadata": sorted(set(names)), "damage": damage}


_READERS: dict[str, Callable[[Path], Any]] = {
    ".yaml": _document,
    ".json": _document,
    ".h": _c_header,
    ".params": _parameter_file,
    ".parm": _parameter_file,
    ".csv": _table,
    ".svg": _figures,
    ".html": _figures,
    ".mcap": _recording,
}


def _files(folder: Path) -> Result:
    """Return the content of every file in a folder; files of one masked name are counted."""
    contents: Result = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = without_varying_parts(path.relative_to(folder).as_posix())
        if name in contents:
            contents[name] = {"files": contents[name].get("files", 1) + 1}
            continue
        reader = _READERS.get(path.suffix)
        contents[name] = {} if reader is None else reader(path)
    return contents


def _without_repeats(value: Any, documents: Result) -> Any:
    """Return output with each document that is also a file replaced by the file's name."""
    if isinstance(value, dict):
        for name, document in documents.items():
            if value and value == document:
                return f"= {name}"
        return {key: _without_repeats(part, documents) for key, part in value.items()}
    if isinstance(value, list):
        return [_without_repeats(part, documents) for part in value]
    return value


def _output(text: str) -> Any:
    """Return the JSON object that a command printed, else its lines as text."""
    try:
        value = json.loads(text)
    except ValueError:
        return {"text": text.splitlines()}
    return value if isinstance(value, dict) else {"text": text.splitlines()}


def result_of(exit_code: int, stdout: str, stderr: str, folder: Path) -> Result:
    """Return what a command left: exit code, output, and the files of its folder."""
    files = masked(_files(folder) if folder.is_dir() else {})
    output = masked(_output(stdout))
    if not isinstance(files, dict):
        raise TypeError("files are a mapping")
    documents = {name: value for name, value in files.items() if name.endswith((".yaml", ".json"))}
    return {
        "exit": exit_code,
        "stdout": _without_repeats(output, documents),
        "stderr": masked({"text": stderr.splitlines()}),
        "files": files,
    }
