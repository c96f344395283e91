"""Facts that stay the same over a recording of one board: site, limits, temperature, motion."""

from dataclasses import dataclass

from gyrorig_solver.model.board_temperature import BoardTemperature
from gyrorig_solver.reference import MotionProfile

STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901


@dataclass(frozen=True, slots=True)
class Site:
    """The location of the rig (metadata `gyrorig.site`); None if it is not recorded."""

    latitude_deg: float | None = None  # north positive
    heading_deg: float | None = None  # of the base's y axis, clockwise from true north
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2


MAX_MEAN_DURATION_S = 0.02  # longer means hide the shape of an edge


@dataclass(frozen=True, slots=True, eq=False)
class RecordingContext:
    """Facts that stay the same over a recording of one board."""

    site: Site = Site()
    temperature: BoardTemperature | None = None
    rad_per_step: tuple[float, float] | None = None  # pan and tilt, with the unit's sign
    motion_profiles: tuple[tuple[int, MotionProfile], ...] = ()  # axis (0 pan, 1 tilt), profile
    begin_s: float = 0.0  # of the recording, on its time axis
    end_s: float = 0.0
    full_scale_rad_s: float | None = None  # of the configured range
    quantum_rad_s: float = 0.0  # one count
    sample_period_s: float | None = None
    mean_duration_s: float = 0.0  # of means that replace the samples; 0: the samples themselves
    # Changes of the limits of pan and tilt by causes: acceleration share, base speed (rad/s).
    limit_changes: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    recording_name: str = ""  # name
    recording_index: int = 0  # among the recordings that are fitted together

    @property
    def is_averaged(self) -> bool:
        """Whether the fit uses means, which hide effects of a few milliseconds."""
        return self.mean_duration_s > MAX_MEAN_DURATION_S
