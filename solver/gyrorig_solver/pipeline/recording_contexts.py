"""Data of a recording that causes beyond the base model use: site, temperature, moves."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.recording_names import distinct_names
from gyrorig_solver.data.metadata_numbers import positive_number
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.samples import mean_temperature_degc as mean_of
from gyrorig_solver.estimate import mean_duration_s
from gyrorig_solver.model import STANDARD_GRAVITY_M_S2, BoardTemperature, RecordingContext, Site
from gyrorig_solver.reference import PanTiltReference, ReferenceMotion


def read_contexts(
    recordings: Sequence[tuple[Recording, GyroSamples, ReferenceMotion | None]],
    mean_degc: float | None = None,
) -> list[RecordingContext]:
    """Return the context of each recording of one board.

    Args:
        recordings: in the order in which they are fitted.
        mean_degc: reference temperature; by default the mean of all recordings, so that one
            polynomial applies to all.

    Raises:
        InputError: the metadata have impossible values.
    """
    recordings = _with_comparable_temperatures(recordings)
    reference_degc = mean_of([s for _, s, _ in recordings]) if mean_degc is None else mean_degc
    names = distinct_names([recording for recording, _, _ in recordings])
    return [
        replace(
            _recording_context(*recording, reference_degc), recording_index=k, recording_name=name
        )
        for k, (recording, name) in enumerate(zip(recordings, names, strict=True))
    ]


def _with_comparable_temperatures(
    recordings: Sequence[tuple[Recording, GyroSamples, ReferenceMotion | None]],
) -> Sequence[tuple[Recording, GyroSamples, ReferenceMotion | None]]:
    """Return recordings without the readings that have no offset, if others have absolute ones.

    Without an offset, only differences within the same thermometer are valid, so a mean of both
    kinds is not a temperature.
    """
    measured = [s for _, s, _ in recordings if s.temperature_degc is not None]
    if len({samples.has_absolute_temperature for samples in measured}) < 2:
        return recordings
    return [
        (
            recording,
            samples
            if samples.has_absolute_temperature
            else replace(samples, temperature_degc=None),
            motion,
        )
        for recording, samples, motion in recordings
    ]


def read_site(recording: Recording) -> Site:
    """Return the site of the rig, as far as the recording has it.

    Raises:
        InputError: an entry is not a number, or not a place on Earth.
    """
    site = recording.metadata.get("gyrorig.site", {})
    latitude = _site_angle(site, "latitude_deg", 90.0)
    heading = _site_angle(site, "heading_deg", 360.0)
    gravity = positive_number(site, "gravity_m_s2") or STANDARD_GRAVITY_M_S2
    return Site(latitude, heading, gravity)


def _site_angle(site: Mapping[str, str], key: str, limit: float) -> float | None:
    text = site.get(key)
    if text is None or text == "":
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not abs(value) <= limit:
        raise InputError(
            f"the {key} of the rig's site in the recording is not valid: {text[:40]!r}",
            f"write a number from -{limit:g} to {limit:g} as {key} under `site` in the rig file, "
            "and record again",
        )
    return value


def _recording_context(
    recording: Recording,
    samples: GyroSamples,
    reference: ReferenceMotion | None,
    reference_degc: float | None,
) -> RecordingContext:
    reading_degc = samples.temperature_degc
    temperature = (
        None
        if reading_degc is None
        else BoardTemperature.of(samples.time_s, reading_degc, reference_degc)
    )
    full_scale_dps = positive_number(samples.metadata, "gyro_full_scale_dps")
    unit = reference if isinstance(reference, PanTiltReference) else None
    return RecordingContext(
        site=read_site(recording),
        temperature=temperature,
        rad_per_step=None if unit is None else unit.rad_per_step,
        motion_profiles=() if unit is None else unit.profiles,
        begin_s=float(samples.time_s[0]),
        end_s=float(samples.time_s[-1]),
        full_scale_rad_s=None if full_scale_dps is None else float(np.radians(full_scale_dps)),
        quantum_rad_s=samples.quantum_rad_s,
        sample_period_s=samples.period_s,
        mean_duration_s=mean_duration_s(samples),
    )
