"""Reader of recordings of format 1: finished or not, sound or damaged.

What to use when: `read_recording` for all data; it returns a `recording.Recording`.
`read_recording_metadata` for the metadata alone, without unpacking a chunk.

Every checksum in the file is verified. Damaged or cut data are left out and reported in
`Recording.losses`; all returned data are exactly as written. A file of another kind, or of another
format, is an InputError.

Speed: each chunk is unpacked once. The offsets of its messages come from the message index and are
verified (`chunk_reader`). numpy copies complete records into one buffer per channel, and the fields
are views of it (`channel_arrays`).

Memory: samples of long recordings are kept as columns (`imu_columns`), pages of the file are
released after reading (`mapped_file`), and other fields are read again when needed.
"""

from functools import partial
from pathlib import Path

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.backup_copies import (
    COPY_NAMES,
    Metadata,
    read_channels_copy,
    read_metadata_copy,
)
from gyrorig_protocol.recording.mcap.losses import Loss, LossCause
from gyrorig_protocol.recording.mcap.mapped_file import map_mcap_file
from gyrorig_protocol.recording.mcap.mcap_summary import McapSummary, read_summary
from gyrorig_protocol.recording.mcap.record_scan import FileScan, scan_records
from gyrorig_protocol.recording.recording import Recording, Topic, is_board_id, parse_board_topic
from gyrorig_protocol.recording.recording_metadata import FORMAT_VERSION
from gyrorig_protocol.recording.topic_collector import MultipleChannelsError, TopicCollector


def read_recording(path: Path) -> Recording:
    """Read a recording.

    Args:
        path: a `.mcap` file, or an unfinished `.mcap.part` file.

    Returns:
        All valid data, and the losses by cause.

    Raises:
        InputError: the file does not exist, is empty, or is of another kind or format.
        MachineError: this computer cannot read it (permissions, disk).
    """
    try:
        path.name.encode()
    except UnicodeEncodeError as fault:
        raise InputError(
            f"the name of the recording {path.name!a} is not a text in UTF-8",
            "rename the file",
        ) from fault
    data = map_mcap_file(path)
    try:
        return _read_mapped(path, data, all_records=False)
    except MultipleChannelsError:
        return _read_mapped(path, data, all_records=True)


def read_recording_metadata(path: Path) -> Metadata:
    """Return a recording's metadata without reading its messages.

    Raises:
        InputError: as `read_recording`.
        MachineError: as `read_recording`.
    """
    data = map_mcap_file(path)
    metadata = _select_metadata(scan_records(data, read_summary(data)))
    _check_format(path, metadata)
    return metadata


def _read_mapped(path: Path, data: memoryview, *, all_records: bool) -> Recording:
    summary = read_summary(data)
    scan = scan_records(data, summary)
    metadata = _select_metadata(scan)
    _check_format(path, metadata)
    if scan.profile != "ros2":
        scan.notes.append(f"the profile is {scan.profile!r}, not 'ros2'")
    _add_copied_channels(scan)
    collector = TopicCollector(path, data, scan, summary.declarations, all_records=all_records)
    collector.read_all()
    topics = collector.build_topics()
    for name in filter(None, map(parse_board_topic, topics)):
        if not is_board_id(name):
            scan.notes.append(
                f"{name[:40]!r} is not a valid board name, so the samples of this board are left "
                "out"
            )
    _report_missing(scan, summary, collector.message_count)
    return Recording(
        path=path,
        metadata=metadata,
        attachments=tuple(
            attachment for attachment in scan.attachments if attachment.name not in COPY_NAMES
        ),
        topics=topics,
        losses=tuple(scan.losses),
        notes=tuple(scan.notes),
        file_bytes=data,
        reread_topic=partial(_reread_topic, path, data),
    )


def _reread_topic(path: Path, data: memoryview, topic: str, field_names: tuple[str, ...]) -> Topic:
    """Read one topic of samples again: these fields, or records without field names."""
    summary = read_summary(data)
    scan = scan_records(data, summary)
    _add_copied_channels(scan)
    collector = TopicCollector(
        path,
        data,
        scan,
        summary.declarations,
        only_topic=topic,
        field_names=field_names,
        all_records=not field_names,
    )
    collector.read_all()
    return collector.build_topics()[topic]


def _add_copied_channels(scan: FileScan) -> None:
    declarations = read_channels_copy(scan.attachments)
    declarations.add_missing_from(scan.declarations)
    scan.declarations = declarations


def _select_metadata(scan: FileScan) -> Metadata:
    """Return the metadata, from the copy with a checksum if there is one."""
    metadata: Metadata = {}
    for name, record in scan.metadata:
        if name in metadata:
            difference = (
                "twice with the same content"
                if metadata[name] == record
                else "twice; the last one is used"
            )
            scan.notes.append(f"metadata {name!r} occurs {difference}")
        metadata[name] = record
    copy = read_metadata_copy(scan.attachments)
    for name, record in copy.items():
        if metadata.get(name) != record:
            text = f"metadata {name!r} is damaged; its checksummed copy is used"
            scan.losses.append(Loss(LossCause.METADATA, 0, 0, 0, text))
    return copy or metadata


def _check_format(path: Path, metadata: Metadata) -> None:
    main_record = metadata.get("gyrorig")
    if main_record is None:
        raise InputError(
            f"{path} is an MCAP file of another program, because it has no gyrorig metadata",
            "convert its data to a recording with `gyrorig import`",
        )
    if main_record.get("format") != FORMAT_VERSION:
        raise InputError(
            f"{path} has the recording format {main_record.get('format')!r}, but this version of "
            f"Gyrorig reads only format {FORMAT_VERSION!r}",
            "use the version of Gyrorig that wrote the file, or a newer one",
        )


def _report_missing(scan: FileScan, summary: McapSummary, message_count: int) -> None:
    """Report a loss if the file counts more messages than were read."""
    if summary.message_count is None or summary.message_count == message_count:
        return
    missing = summary.message_count - message_count
    if missing < 0:
        scan.notes.append(
            f"the summary of the file counts {summary.message_count} messages, but the file "
            f"contains {message_count}"
        )
        return
    stated_losses = [loss for loss in scan.losses if loss.cause is not LossCause.MESSAGE]
    if sum(loss.messages or 0 for loss in stated_losses) == missing:
        return
    text = f"the file counts {missing} messages more than were read"
    scan.losses.append(Loss(LossCause.MISSING, 0, 0, missing, text))
