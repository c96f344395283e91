"""The likelihood of each level of a bias random walk, with flicker of any level.

The flicker of parts differs by more than a factor of ten. Therefore a random walk is unusual only
if no level of the flicker explains the low frequencies as well.

What to use when: `profile_walks` for a fit, one profile per recording and axis;
`profile_common_walks` for one walk in all recordings; `fit_usual_noises` for the levels of a usual
part.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import (
    PRIOR_LOG_STD,
    ConvergedFit,
    NoiseModel,
    Spectrum,
    nominal_levels,
)

FLICKER, WALK = 1, 2  # indices of the levels of a noise model
# Relative to the power of the typical 4 mdps of the L3G4200D: the amplitude of a usual part is up
# to four times larger. A bias that jumps between two values for 40 s looks like flicker of six
# times that amplitude.
USUAL_FLICKER_POWER_FACTOR = 16.0
TYPICAL_POWER_FACTOR = 4.0  # relative to the power of a typical part's random walk
# Range of the logarithm of a level to each side of that of a typical part: 400 times its amplitude.
MAX_LOG_LEVEL_SHIFT = 12.0
LEVEL_GRID_POINTS = 241  # levels of the walk in this range
FLICKER_GRID_STEP = 4  # every fourth of these is a level of the flicker, which is less critical


@dataclass(frozen=True, slots=True, eq=False)
class WalkProfile:
    """The profile log-likelihood of the random walk on one axis, of one recording or several."""

    log_levels: FloatArray  # (points,), with that of a typical part in the middle
    nats: FloatArray  # (points,), minus that of the best typical walk; flicker of any level

    @property
    def gain_nats(self) -> float:
        """The log-likelihood of the best level minus that of the best typical level."""
        return max(float(self.nats.max()), 0.0)

    def posterior_level(self) -> tuple[float, float]:
        """Return the posterior mean and standard deviation of the square root of the level."""
        deviation = (self.log_levels - self.log_levels.mean()) / PRIOR_LOG_STD
        log_posterior = self.nats - 0.5 * deviation**2
        weight = np.exp(log_posterior - log_posterior.max())
        weight /= weight.sum()
        root = np.exp(0.5 * self.log_levels)
        mean = float(weight @ root)
        return mean, float(np.sqrt(weight @ (root - mean) ** 2))


def profile_walks(solution: ConvergedFit) -> list[WalkProfile]:
    """Return the profile of each axis of each recording, in the order of the recordings."""
    return [
        _LevelGrid.of(spectrum, noise, axis).profile_walk()
        for spectrum, noise in zip(solution.spectra, solution.noises, strict=True)
        for axis in range(3)
    ]


def profile_common_walks(solution: ConvergedFit) -> list[WalkProfile]:
    """Return the profile of each axis of one walk that acts in all recordings.

    An axis has one level, and so one degree of freedom, however many recordings there are.
    """
    profiles = profile_walks(solution)
    return [add_profiles(profiles[axis::3]) for axis in range(3)]


def add_profiles(profiles: Sequence[WalkProfile]) -> WalkProfile:
    """Return the profile of one walk that acts in several recordings of the same axis.

    The white noise of the recordings can differ, and with it the level of a typical part. The
    levels of the result lie around the mean of the typical ones. Beyond the levels of a recording,
    its log-likelihood is that of the nearest level.

    Args:
        profiles: of one axis, one per recording, at least one.
    """
    middles = np.array([profile.log_levels.mean() for profile in profiles])
    log_levels = profiles[0].log_levels + (middles.mean() - middles[0])
    nats = [np.interp(log_levels, profile.log_levels, profile.nats) for profile in profiles]
    return WalkProfile(log_levels, np.sum(nats, axis=0))


def fit_usual_noises(solution: ConvergedFit) -> list[NoiseModel]:
    """Return the noise of each recording with the best levels that usual parts have."""
    noises = []
    for spectrum, noise in zip(solution.spectra, solution.noises, strict=True):
        levels = noise.levels.copy()
        for axis in range(3):
            grid = _LevelGrid.of(spectrum, noise, axis)
            if levels[axis, FLICKER] > grid.max_flicker or levels[axis, WALK] > grid.max_walk:
                levels[axis, [FLICKER, WALK]] = grid.best_usual_levels()
        noises.append(replace(noise, levels=levels))
    return noises


@dataclass(frozen=True, slots=True, eq=False)
class _LevelGrid:
    """The log-likelihood of an axis' spectrum over the levels of flicker and random walk."""

    log_flicker: FloatArray  # (f,)
    log_walk: FloatArray  # (w,)
    nats: FloatArray  # (f, w)
    max_flicker: float  # of usual parts
    max_walk: float

    @classmethod
    def of(cls, spectrum: Spectrum, noise: NoiseModel, axis: int) -> "_LevelGrid":
        """Return the grid of an axis; its other levels are those of the fit."""
        typical = nominal_levels(float(noise.levels[axis, 0]))
        shifts = np.linspace(-MAX_LOG_LEVEL_SHIFT, MAX_LOG_LEVEL_SHIFT, LEVEL_GRID_POINTS)
        shape = spectrum.unit_densities(noise.sampling).copy()
        if spectrum.white_power is not None:
            shape[0] *= spectrum.white_power[:, axis]
        other_levels = np.append(noise.levels[axis], noise.floor_and_rounding[axis])
        other_levels[[FLICKER, WALK]] = 0.0
        other_density = other_levels @ shape
        log_walk = np.log(typical[WALK]) + shifts
        log_flicker = np.log(typical[FLICKER]) + shifts[::FLICKER_GRID_STEP]
        walk_density = np.exp(log_walk)[:, None] * shape[WALK]
        nats = np.empty((log_flicker.size, log_walk.size))
        for k, log_level in enumerate(log_flicker):
            density = other_density + np.exp(log_level) * shape[FLICKER] + walk_density
            misfit = np.log(density) + spectrum.density[:, axis] / density
            nats[k] = -0.5 * misfit @ spectrum.count
        max_flicker = float(USUAL_FLICKER_POWER_FACTOR * typical[FLICKER])
        max_walk = float(TYPICAL_POWER_FACTOR * typical[WALK])
        return cls(log_flicker, log_walk, nats, max_flicker, max_walk)

    def profile_walk(self) -> WalkProfile:
        """Return the profile of the walk, with flicker of any level."""
        nats = self.nats.max(axis=0)
        usual = self.log_walk <= np.log(self.max_walk)
        return WalkProfile(self.log_walk, nats - float(nats[usual].max()))

    def best_usual_levels(self) -> tuple[float, float]:
        """Return the best levels of flicker and walk that usual parts have."""
        unusual = (self.log_flicker > np.log(self.max_flicker))[:, None] | (
            self.log_walk > np.log(self.max_walk)
        )
        best = np.argmax(np.where(unusual, -np.inf, self.nats))
        flicker, walk = np.unravel_index(best, self.nats.shape)
        return float(np.exp(self.log_flicker[flicker])), float(np.exp(self.log_walk[walk]))
