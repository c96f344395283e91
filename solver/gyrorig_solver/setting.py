"""What causes beyond the base model may look at, from a recording: site, temperature, moves."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.model.terms.scene import STANDARD_GRAVITY_M_S2, Setting, Site
from gyrorig_solver.model.terms.temperature import Temperature
from gyrorig_solver.reference.motion import ReferenceMotion
from gyrorig_solver.reference.ptu import PtuReference
from gyrorig_solver.samples import GyroSamples, number
from gyrorig_solver.samples import mean_degc as mean_of


def settings_of(
    recordings: Sequence[tuple[Recording, GyroSamples, ReferenceMotion | None]],
    mean_degc: float | None = None,
) -> list[Setting]:
    """Return the setting of each recording of one board.

    Args:
        recordings: in the order in which they are fitted.
        mean_degc: what temperatures count from; by default the mean of all recordings, so
            that one polynomial holds.

    Raises:
        InputError: the metadata say what cannot be.
    """
    mean = mean_of([s for _, s, _ in recordings]) if mean_degc is None else mean_degc
    return [replace(_setting(*one, mean), number=k) for k, one in enumerate(recordings)]


def site_of(recording: Recording) -> Site:
    """Return where the rig stands, as far as the recording says.

    Raises:
        InputError: an entry is no number, or no place on Earth.
    """
    said = recording.metadata.get("gyrorig.site", {})
    latitude, heading = _angle(said, "latitude_deg", 90.0), _angle(said, "heading_deg", 360.0)
    gravity = number(said, "gravity_m_s2") or STANDARD_GRAVITY_M_S2
    return Site(latitude, heading, gravity)


def _angle(said: Mapping[str, str], key: str, most: float) -> float | None:
    text = said.get(key)
    if text is None or text == "":
        return None
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not abs(value) <= most:
        raise InputError(
            f"the recording says {key} {text[:40]!r} of its site",
            f"give it from -{most:g} to {most:g} under site in the rig file, and record again",
        )
    return value


def _setting(
    recording: Recording,
    samples: GyroSamples,
    reference: ReferenceMotion | None,
    mean: float | None,
) -> Setting:
    degc = samples.temperature_degc
    temperature = None if degc is None else Temperature.of(samples.time_s, degc, mean)
    full_scale_dps = number(samples.metadata, "gyro_full_scale_dps")
    unit = reference if isinstance(reference, PtuReference) else None
    return Setting(
        site=site_of(recording),
        temperature=temperature,
        rad_per_step=None if unit is None else unit.rad_per_step,
        courses=() if unit is None else unit.courses,
        begin_s=float(samples.time_s[0]),
        end_s=float(samples.time_s[-1]),
        full_scale_rad_s=None if full_scale_dps is None else float(np.radians(full_scale_dps)),
        quantum_rad_s=samples.quantum_rad_s,
        sample_period_s=samples.period_s,
        recording=recording.path.name,
    )
