"""The twin of a rig, from the fits of its boards.

What to use when: `build_twin` with the result of `pipeline` for each board; `write_twin` for the
folder of the twin.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version as installed_version
from itertools import count
from pathlib import Path
from typing import Any

from gyrorig_protocol.documents import dump_yaml, finite_values
from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_protocol.recording.recording import Recording, in_order_of_time
from gyrorig_protocol.twin import Twin, TwinRecording, check_twin, twin_to_plain
from gyrorig_solver.data.utc_time import utc_text_now
from gyrorig_solver.pipeline import BoardData, CriticisedFit, has_unit
from gyrorig_solver.storage import write_file
from gyrorig_solver.twin.board_measurement import measure_board
from gyrorig_solver.twin.joint_covariance import join_covariances
from gyrorig_solver.twin.link_measurement import MeasuredLink, measure_link
from gyrorig_solver.twin.rig_mapping import build_rig_mapping
from gyrorig_solver.twin.twin_causes import collect_causes
from gyrorig_solver.twin.unit_measurement import (
    UNIT_RECORD,
    MeasuredUnit,
    first_move_s,
    measure_unit,
)

TWIN_NAME = "twin.yaml"
# Metadata that distinguish two rigs, by record.
RIG_KEYS = {UNIT_RECORD: ("driver", "model", "dialect", "serial"), "gyrorig": ("uid", "rig")}
SAME_RIG_REMEDY = "give the recordings of one rig only"


@dataclass(frozen=True, slots=True, eq=False)
class BuiltTwin:
    """A twin with its rig file, and the causes and values that it lacks."""

    twin: Twin
    rig: dict[str, Any]  # the whole document
    verdicts: Mapping[str, str]  # of the findings, by board
    # of each cause: the causes that the data do not exclude
    alternatives: tuple[tuple[str, ...], ...]
    not_emulated: tuple[str, ...]  # named causes that the emulated rig does not have
    missing: tuple[str, ...] = ()  # what the recordings report as missing


def check_one_rig(recordings: Sequence[Recording]) -> None:
    """Raise an error for recordings of different rigs, or with the same file name.

    Raises:
        UsageError: the rigs, the units, or boards with the same name differ between two recordings,
            only one of them has a unit, or two have the same file name.
    """
    name, count_of_name = Counter(r.path.name for r in recordings).most_common(1)[0]
    if count_of_name > 1:
        raise UsageError(
            f"{count_of_name} recordings have the file name {name}, but a twin refers to its "
            "recordings by their names",
            "rename the files so that each has a different name",
        )
    with_unit = [recording.path.name for recording in recordings if has_unit([recording])]
    without = [recording.path.name for recording in recordings if not has_unit([recording])]
    if with_unit and without:
        raise UsageError(
            f"the recording {with_unit[0]} has a motion unit and {without[0]} has none, but a twin "
            "is of one rig",
            SAME_RIG_REMEDY,
        )
    seen: dict[tuple[str, str], tuple[str, str]] = {}
    for recording in recordings:
        for record, facts in recording.metadata.items():
            for key in RIG_KEYS.get(record.partition(".board.")[0], ()):
                value = facts.get(key, "")
                if not value:
                    continue
                first, name = seen.setdefault((record, key), (value, recording.path.name))
                if first != value:
                    device = record.removeprefix("gyrorig.").replace("ptu", "unit")
                    device = device.replace("board.", "board ")
                    words = "name of the rig" if key == "rig" else f"{key} of the {device}"
                    raise UsageError(
                        f"the {words} is {first:.40} in {name} and {value:.40} in "
                        f"{recording.path.name}, but a twin is of one rig",
                        SAME_RIG_REMEDY,
                    )


def build_twin(boards: Mapping[str, BoardData], fits: Mapping[str, CriticisedFit]) -> BuiltTwin:
    """Return the twin of the boards on one rig.

    Args:
        boards: at least one, with their recordings.
        fits: of the same boards, with their findings.
    """
    recordings = in_order_of_time(
        list({r.sha256: r for data in boards.values() for r in data.recordings}.values())
    )
    link = measure_link(boards)
    collected = collect_causes(fits, [recording.path.name for recording in recordings])
    unit = _measure_unit(boards, fits, link)
    twin = Twin(
        schema="gyrorig/twin/1",
        created=utc_text_now(),
        software=installed_version("gyrorig"),
        recordings=tuple(_recording_entry(recording, boards) for recording in recordings),
        unit=None if unit is None else unit.section,
        link=link.section,
        boards={name: measure_board(data, fits[name]) for name, data in boards.items()},
        causes=tuple(collected.causes),
        posterior=join_covariances(fits, collected, unit, link.section),
    )
    check_twin(twin, TWIN_NAME, InputError)
    rig = build_rig_mapping(recordings[-1], twin)
    rig["twin"] = finite_values(twin_to_plain(twin))
    return BuiltTwin(
        twin,
        rig,
        {
            name: fit.explanation.findings.verdict
            for name, fit in fits.items()
            if fit.explanation is not None
        },
        tuple(collected.alternatives),
        tuple(dict.fromkeys(collected.not_emulated)),
        tuple(
            f"{r.path.name}: {'; '.join(loss.text for loss in r.losses)}"
            for r in recordings
            if r.losses
        ),
    )


def write_twin(out: Path, built: BuiltTwin) -> Path:
    """Write the rig file of a twin, `OUT/twin.yaml`; rename an earlier one to `twin-0001.yaml`.

    Raises:
        MachineError: the folder cannot be created or written.
    """
    path = out / TWIN_NAME
    if path.exists():
        _keep_earlier(path)
    write_file(path, dump_yaml(built.rig).encode(), replace=False, make_folder=True)
    return path


def _keep_earlier(path: Path) -> None:
    """Rename an earlier twin to the next free number."""
    earlier_path = next(
        new
        for number in count(1)
        if not (new := path.with_name(f"{path.stem}-{number:04d}{path.suffix}")).exists()
    )
    try:
        path.rename(earlier_path)
    except OSError as fault:
        raise MachineError(
            f"the file {path} cannot be renamed ({fault.strerror})",
            "choose another folder with --out",
        ) from fault


def _recording_entry(recording: Recording, boards: Mapping[str, BoardData]) -> TwinRecording:
    """Return a recording with its times on the axis of its first board."""
    samples = next(
        samples
        for data in boards.values()
        for r, samples in zip(data.recordings, data.samples, strict=True)
        if r.sha256 == recording.sha256
    )
    return TwinRecording(
        name=recording.path.name,
        sha256=recording.sha256,
        begin_s=float(samples.time_s[0]),
        end_s=float(samples.time_s[-1]),
        first_move_s=first_move_s(recording, samples.origin_ns) if has_unit([recording]) else None,
    )


def _measure_unit(
    boards: Mapping[str, BoardData], fits: Mapping[str, CriticisedFit], link: MeasuredLink
) -> MeasuredUnit | None:
    """Return the unit from the last recording that has one, None without a unit."""
    for name, data in boards.items():
        solution = fits[name].solution
        if solution is None:
            continue
        for recording, session in zip(
            reversed(data.recordings), reversed(solution.sessions), strict=True
        ):
            if has_unit([recording]):
                return measure_unit(recording, session.reference, link.host_latency)
    return None
