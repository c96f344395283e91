"""The table of prior sizes and limits, and a user's changes of it."""

import math

import pytest

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.model import PARAMETER_GROUPS
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.uncertainty import default_settings
from gyrorig_solver.uncertainty.uncertainty_settings import parse_settings

HEAD = "schema: gyrorig/uncertainty/1\n"
# What a calibration's parameters contain by their definition, and what the data always show.
WITHOUT_PRIOR = {
    *("axis_swap", "sign_flip", "wrong_full_scale", "clock_offset", "earth_rotation"),
    *("bias_random_walk", "sample_jitter", "corrupt_samples", "repeated_samples", "lost_samples"),
    "clock_sawtooth",  # a few sizes and times; where it is present, the lag by time shows it
}


def test_every_cause_has_a_prior_size_or_a_reason() -> None:
    named = set(default_settings().prior_sizes)
    assert named | WITHOUT_PRIOR == set(catalogue())
    assert not named & WITHOUT_PRIOR


def test_every_kind_of_parameter_has_a_limit() -> None:
    assert set(default_settings().limits) == {group.name for group in PARAMETER_GROUPS}


def test_sizes_are_within_the_range_of_their_cause() -> None:
    for cause, prior in default_settings().prior_sizes.items():
        sizes = [p for p in catalogue()[cause].parameters if p.role == "size"]
        assert all(prior.size <= size.upper for size in sizes), cause
        assert len({size.unit for size in sizes}) == 1, cause


def test_a_user_replaces_single_entries() -> None:
    text = HEAD + 'unit: {tilt_sag: {size: 0.02, unit: deg, source: "measured"}}\n'
    settings = parse_settings(text, "own.yaml")
    assert settings.prior_sizes["tilt_sag"].std == pytest.approx(math.radians(0.02))
    assert settings.prior_sizes["backlash"] == default_settings().prior_sizes["backlash"]
    assert settings.limits == default_settings().limits
    assert settings.sha256 != default_settings().sha256


def test_the_si_unit_is_taken_too() -> None:
    text = HEAD + 'unit: {tilt_sag: {size: 0.001, unit: rad, source: "measured"}}\n'
    assert parse_settings(text, "own.yaml").prior_sizes["tilt_sag"].std == pytest.approx(0.001)


def test_a_probability_reduces_the_second_moment() -> None:
    text = HEAD + 'board: {bias_step: {size: 2.0, unit: deg/s, probability: 0.25, source: "s"}}\n'
    step = parse_settings(text, "own.yaml").prior_sizes["bias_step"]
    assert step.std == pytest.approx(math.radians(1.0))


def test_a_limit_is_in_the_unit_that_is_shown() -> None:
    text = HEAD + 'limits: {misalignment: {std: 1.0, unit: deg, reason: "r"}}\n'
    assert parse_settings(text, "own.yaml").limits["misalignment"] == pytest.approx(math.pi / 180)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('unit: {sag: {size: 1.0, unit: deg, source: "s"}}', "'sag' is not the name"),
        ('unit: {bias_step: {size: 1.0, unit: deg/s, source: "s"}}', "is a cause of the board"),
        (
            'unit: {tilt_sag: {size: 1.0, unit: mm, source: "s"}}',
            "wrong unit of measure, 'mm'",
        ),
        ('unit: {tilt_sag: {size: -1.0, unit: deg, source: "s"}}', "size"),
        ("unit: {tilt_sag: {size: 1.0, unit: deg}}", "source"),
        ('unit: {tilt_sag: {size: 1.0, unit: deg, source: "s", std: 1.0}}', "std"),
        ('board: {bias_step: {size: 1.0, unit: deg/s, probability: 2.0, source: "s"}}', "probab"),
        ('limits: {gain: {std: 1.0, unit: deg, reason: "r"}}', "unknown parameter 'gain'"),
        ('limits: {bias: {std: 1.0, unit: rad/s, reason: "r"}}', "wrong unit of measure, 'rad/s'"),
        ("limits: {bias: {std: 0.0, unit: deg/s, reason: r}}", "std"),
    ],
)
def test_other_documents_are_refused(text: str, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        parse_settings(f"{HEAD}{text}\n", "own.yaml")


def test_other_drifts_are_other_settings() -> None:
    drift = 'drift_per_day: {tilt_sag: {std: 0.02, unit: deg, reason: "measured"}}\n'
    settings = parse_settings(HEAD + drift, "own.yaml")
    assert settings.prior_sizes == default_settings().prior_sizes
    assert settings.sha256 != default_settings().sha256
