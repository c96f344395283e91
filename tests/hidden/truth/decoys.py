"""Decoys that must not cause a false alarm: a warm board, and an idle channel."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_daemon.emulator.rig_truth import RigTruth, sample_rig_truth

IDLE_TOPIC = "/room/humidity"
_PERIOD_NS = 500_000_000


def make_hot_truth(settings: RigSettings) -> RigTruth:
    """Return a rig whose boards warm up slowly by 15 to 30 K, without any effect on their rates."""
    truth = sample_rig_truth(settings)
    rng = np.random.default_rng([settings.seed, 0x484F54])
    boards = {
        name: replace(
            board,
            imu=replace(
                board.imu,
                self_heating_k=float(rng.uniform(15.0, 30.0)),
                warm_up_s=float(rng.uniform(300.0, 900.0)),
            ),
        )
        for name, board in truth.boards.items()
    }
    return replace(truth, boards=boards)


def add_idle_channel(path: Path, seed: int) -> None:
    """Add a channel with a random walk, which no other data depend on, to a recording."""
    idle_path = path.with_name(path.name + ".idle")
    rng = np.random.default_rng([seed, 0x49444C45])
    with path.open("rb") as source, idle_path.open("wb") as file:
        reader = make_reader(source)
        header = reader.get_header()
        writer = Writer(file)
        writer.start(header.profile, header.library)
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time, attachment.log_time, attachment.name,
                attachment.media_type, attachment.data,
            )  # fmt: skip
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, dict(record.metadata))
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        idle = writer.register_channel(IDLE_TOPIC, "json", 0)
        value, due_ns = 45.0, 0
        for schema, channel, message in reader.iter_messages():
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding,
                    schemas[schema.id] if schema else 0, dict(channel.metadata),
                )  # fmt: skip
            if message.log_time >= due_ns:
                value += float(rng.normal(0.0, 0.3))
                data = json.dumps({"percent": round(value, 2)}).encode()
                writer.add_message(idle, message.log_time, data, message.log_time)
                due_ns = message.log_time + _PERIOD_NS
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time,
                message.sequence,
            )  # fmt: skip
        writer.finish()  # type: ignore[no-untyped-call]
    idle_path.replace(path)
