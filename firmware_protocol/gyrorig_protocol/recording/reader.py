"""Read a recording of format 1: finished or not, whole or damaged.

What to use when: `read_recording(path)`; see `recording.Recording` for what comes back.
`read_head` for its metadata alone, without opening a chunk.

Every checksum that the file carries is checked. What is damaged or cut is left out and
stated in `Recording.losses`; what is left is exactly what was written. A file that is
no recording at all, or of another format, is an InputError.

How it is fast: each chunk is unpacked once, the offsets of its messages come from the
message index and are proven (`chunks`), and whole records are gathered by numpy into
one buffer per channel, into which the fields are views (`arrays`).

How it stays small: samples of long recordings are kept as columns (`imu_columns`), pages
of the file are let go behind the reader (`mapped`), and what was not kept is read again.
"""

from functools import partial
from pathlib import Path

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.collect import Collector, SeveralChannelsError
from gyrorig_protocol.recording.copies import NAMES, Metadata, read_channels, read_metadata
from gyrorig_protocol.recording.framing import Walk, walk
from gyrorig_protocol.recording.head import FORMAT
from gyrorig_protocol.recording.losses import Loss, LossCause
from gyrorig_protocol.recording.mapped import map_file
from gyrorig_protocol.recording.recording import Recording, Topic, board_of, is_board_id
from gyrorig_protocol.recording.summary import MAGIC, Summary, read_summary


def read_recording(path: Path) -> Recording:
    """Read a recording.

    Args:
        path: a `.mcap`, or a `.mcap.part` that was never finished.

    Returns:
        Everything that is sound, and what is not, by cause.

    Raises:
        InputError: no such file, empty, foreign, another format, other fields.
        MachineError: this computer cannot read it (permissions, disk).
    """
    data = map_file(path)
    if data[: len(MAGIC)] != MAGIC:
        raise InputError(
            f"{path} is no MCAP file",
            "measurements of other kinds become a recording by gyrorig import",
        )
    try:
        return _read(path, data, all_records=False)
    except SeveralChannelsError:
        return _read(path, data, all_records=True)


def read_head(path: Path) -> Metadata:
    """Return a recording's metadata without reading its messages.

    Raises:
        InputError: as `read_recording`.
        MachineError: as `read_recording`.
    """
    data = map_file(path)
    if data[: len(MAGIC)] != MAGIC:
        raise InputError(
            f"{path} is no MCAP file",
            "measurements of other kinds become a recording by gyrorig import",
        )
    metadata = _metadata(walk(data, read_summary(data)))
    _check_format(path, metadata)
    return metadata


def _read(path: Path, data: memoryview, *, all_records: bool) -> Recording:
    summary = read_summary(data)
    found = walk(data, summary)
    metadata = _metadata(found)
    _check_format(path, metadata)
    if found.profile != "ros2":
        found.notes.append(f"the profile is {found.profile!r}, not 'ros2'")
    _know_channels(found)
    collector = Collector(path, data, found, summary.declared, all_records=all_records)
    collector.take_all()
    topics = collector.topics()
    for name in filter(None, map(board_of, topics)):
        if not is_board_id(name):
            found.notes.append(f"{name[:40]!r} is no board name: its samples are not offered")
    _state_missing(found, summary, collector.seen)
    return Recording(
        path=path,
        metadata=metadata,
        attachments=tuple(a for a in found.attachments if a.name not in NAMES),
        topics=topics,
        losses=tuple(found.losses),
        notes=tuple(found.notes),
        file=data,
        read_again=partial(_read_again, path, data),
    )


def _read_again(path: Path, data: memoryview, topic: str, names: tuple[str, ...]) -> Topic:
    """Go through the file once more for one topic of samples: these fields, or records."""
    summary = read_summary(data)
    found = walk(data, summary)
    _know_channels(found)
    collector = Collector(
        path, data, found, summary.declared, only=topic, names=names, all_records=not names
    )
    collector.take_all()
    return collector.topics()[topic]


def _know_channels(found: Walk) -> None:
    copied = read_channels(found.attachments)
    copied.fill_from(found.declared)
    found.declared = copied


def _metadata(found: Walk) -> Metadata:
    """The metadata, from the checksummed copy where there is one."""
    metadata: Metadata = {}
    for name, record in found.metadata:
        if name in metadata:
            same = "twice, alike" if metadata[name] == record else "twice; the last one counts"
            found.notes.append(f"metadata {name!r} is there {same}")
        metadata[name] = record
    copy = read_metadata(found.attachments)
    for name, record in copy.items():
        if metadata.get(name) != record:
            text = f"metadata {name!r} is damaged; its checksummed copy is used"
            found.losses.append(Loss(LossCause.METADATA, 0, 0, 0, text))
    return copy or metadata


def _check_format(path: Path, metadata: Metadata) -> None:
    own = metadata.get("gyrorig")
    if own is None:
        raise InputError(
            f"{path} holds no gyrorig metadata",
            "it is another program's MCAP: make a recording of its data with `gyrorig import`",
        )
    if own.get("format") != FORMAT:
        raise InputError(
            f"{path} is of format {own.get('format')!r}",
            f"this version reads {FORMAT!r}: take the version that wrote it, or a newer one",
        )


def _state_missing(found: Walk, summary: Summary, seen: int) -> None:
    """Compare with the file's own count of its messages."""
    if summary.messages is None or summary.messages == seen:
        return
    missing = summary.messages - seen
    if missing < 0:
        found.notes.append(f"the file counts {summary.messages} messages but holds {seen}")
        return
    stated = [loss for loss in found.losses if loss.cause is not LossCause.MESSAGE]
    if sum(loss.messages or 0 for loss in stated) == missing:
        return
    text = f"the file counts {missing} messages more than could be read"
    found.losses.append(Loss(LossCause.MISSING, 0, 0, missing, text))
