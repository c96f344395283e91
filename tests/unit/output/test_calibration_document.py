"""The calibration document: exact text, round trip, nulls and errors."""

import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.profile import parse_profile
from gyrorig_solver.calibration import (
    CalibrationDocument,
    Parameter,
    calibration_as_mapping,
    calibration_wording,
    parse_calibration,
)
from gyrorig_solver.calibration.calibration_builder import Provenance, build_calibration
from gyrorig_solver.calibration.calibration_document import FindingsReference, calibration_as_yaml
from gyrorig_solver.calibration.calibration_summary import calibration_summary
from gyrorig_solver.estimate import GyroFit, motion_fit
from gyrorig_solver.model import format_quantity

GOLDEN = Path(__file__).parent / "golden"
BOARDS = Path(__file__).parents[3] / "config" / "boards"


def made(fit: GyroFit, origin: Provenance) -> CalibrationDocument:
    return build_calibration(fit, origin)


def assert_same_text(text: str, golden: str) -> None:
    """Compare texts exactly, except floats from LAPACK, which may differ in the last bit."""
    number = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?")
    assert number.sub("#", text) == number.sub("#", golden)
    numbers = [float(t) for t in number.findall(text)]
    np.testing.assert_allclose(
        numbers, [float(t) for t in number.findall(golden)], rtol=1e-12, atol=1e-15
    )


@pytest.mark.parametrize("name", ["good", "limited"])
def test_document_equals_golden_text(
    name: str, request: pytest.FixtureRequest, provenance: Provenance
) -> None:
    fit = request.getfixturevalue(f"{name}_fit")
    document = made(fit, provenance)
    assert_same_text(calibration_as_yaml(document), (GOLDEN / f"{name}.yaml").read_text())
    assert calibration_summary(document) + "\n" == (GOLDEN / f"{name}.txt").read_text()


@pytest.mark.parametrize("name", ["good", "limited"])
def test_document_matches_the_contract(name: str, contract_judge: Path) -> None:
    path = GOLDEN / f"{name}.yaml"
    judged = subprocess.run(
        [sys.executable, str(contract_judge), str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout


def test_document_round_trip(good_fit: GyroFit, provenance: Provenance) -> None:
    document = made(good_fit, provenance)
    assert parse_calibration(calibration_as_yaml(document), "text") == document


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_any_float_round_trip(value: float, good_fit: GyroFit, provenance: Provenance) -> None:
    fit = replace(good_fit, bias_rad_s=np.array([value, 0.0, 0.0]))
    document = made(fit, provenance)
    back = parse_calibration(calibration_as_yaml(document), "text").parameters["bias"].value
    assert isinstance(back, list)
    assert back[0] == value


def test_unobservable_parameters_are_null_and_listed(
    limited_fit: GyroFit, provenance: Provenance
) -> None:
    plain = calibration_as_mapping(made(limited_fit, provenance))
    assert plain["parameters"]["scale"]["value"] == [None, None, None]
    assert "scale.x" in plain["observability"]["unobservable"]
    assert plain["matrices"]["STM"][0][0] is None
    assert plain["matrices"]["STM"][0][2] is not None
    assert plain["trust"]["verdict"] == "limited"
    assert "sweep it too" in plain["trust"]["reasons"][0]


@pytest.mark.parametrize(
    ("change", "verdict", "word"),
    [
        ({}, "good", ""),
        ({"reduced_chi2": 100.0}, "refused", "residual"),
        ({"lost": 5000}, "limited", "lost"),
        ({"outliers": 500}, "limited", "outliers"),
        ({"limited_reasons": ("the unit stalled: free the cable",)}, "limited", "stalled"),
        ({"reduced_chi2": math.nan}, "good", ""),
    ],
)
def test_verdict_follows_from_reasons(
    change: dict[str, object],
    verdict: str,
    word: str,
    good_fit: GyroFit,
    provenance: Provenance,
) -> None:
    trust = made(replace(good_fit, **change), provenance).trust  # type: ignore[arg-type]
    assert trust.verdict == verdict
    assert word in " ".join(trust.reasons)


def test_values_outside_the_data_sheet_give_warnings(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    profile = parse_profile((BOARDS / "L3G4200D.yaml").read_text(), "L3G4200D.yaml")
    fit = replace(good_fit, scale=np.array([2.0, 1.0, 1.0]), bias_rad_s=np.array([0.0, 0.0, 0.6]))
    document = build_calibration(fit, provenance, profile)
    assert [w.split(" ")[0] for w in document.quality.warnings] == ["scale.x", "bias.z"]
    assert "±25" in document.quality.warnings[1]
    config = msgspec.structs.replace(provenance.board.config, gyro_full_scale_dps=2000.0)
    wide = replace(provenance, board=msgspec.structs.replace(provenance.board, config=config))
    document = build_calibration(fit, wide, profile)
    assert [w.split(" ")[0] for w in document.quality.warnings] == ["scale.x"]  # ±187.5 there


@pytest.mark.parametrize(
    ("signs", "words"),
    [
        ([1.0, 1.0, 1.0], ""),
        ([-1.0, -1.0, 1.0], ""),  # a board that is mounted in a rotated position
        ([-1.0, 1.0, 1.0], "axis x has the wrong sign: the gain is mirrored"),
        ([-1.0, -1.0, -1.0], "the unit's pan_sign and tilt_sign can be wrong instead"),
    ],
)
def test_a_mirrored_gain_is_a_remark(
    signs: list[float], words: str, good_fit: GyroFit, provenance: Provenance
) -> None:
    """Before, the findings alone named it."""
    fit = replace(good_fit, gain=np.diag(signs) @ good_fit.gain)
    of_turns = replace(fit, terms=("bias", "scale", "nonorthogonality", "misalignment"))
    assert not made(of_turns, provenance).quality.warnings  # their estimator states a reason
    document = made(fit, provenance)
    assert document.trust.verdict == "good"
    assert len(document.quality.warnings) == (1 if words else 0)
    assert words in "".join(document.quality.warnings)
    assert ("  remark: axis " in calibration_summary(document)) == bool(words)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[1, 2]",
        "schema: gyrorig/calibration/2",
        "schema: gyrorig/calibration/1\nboard: 3",
        "schema: &a gyrorig/calibration/1\nboard: *a",
        "\x00",
    ],
)
def test_other_documents_give_a_one_line_error(text: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_calibration(text, "v0001.yaml")
    assert "\n" not in str(refused.value)
    assert "v0001.yaml" in str(refused.value)


def test_unknown_keys_are_errors(good_fit: GyroFit, provenance: Provenance) -> None:
    text = calibration_as_yaml(made(good_fit, provenance)) + "surprise: 1\n"
    with pytest.raises(InputError, match="surprise"):
        parse_calibration(text, "v0001.yaml")


@pytest.mark.parametrize("path", sorted(BOARDS.glob("*.yaml")), ids=lambda p: p.stem)
def test_every_profile_has_its_name_and_source(path: Path) -> None:
    profile = parse_profile(path.read_text(), path.name)
    assert profile.sensor == path.stem
    assert "data sheet" in profile.source or "specification" in profile.source


@pytest.mark.parametrize(
    ("value", "std", "texts"),
    [
        (0.123456, 0.0012, ("+0.1235", "0.0012")),
        (-12.3, 4.5, ("-12.3", "4.5")),
        (1.0, None, ("+1", "unknown")),
        (1.0, 0.0, ("+1", "0")),  # chosen, not measured
    ],
)
def test_digits_follow_the_uncertainty(
    value: float, std: float | None, texts: tuple[str, str]
) -> None:
    assert format_quantity(value, std) == texts


@pytest.mark.parametrize(
    ("skew_ppm", "recorded"), [(-31.5, -31.5), (0.02, 0.02), (2e-5, None), (math.nan, None)]
)
def test_clock_skew_is_recorded_only_for_a_second_clock(
    good_fit: GyroFit, provenance: Provenance, skew_ppm: float, recorded: float | None
) -> None:
    assert good_fit.clock is not None
    fit = replace(good_fit, clock=replace(good_fit.clock, skew_ppm=skew_ppm))
    assert made(fit, provenance).quality.clock_skew_ppm == recorded
    assert made(replace(good_fit, clock=None), provenance).quality.clock_skew_ppm is None


def test_the_stated_limit_is_the_one_that_the_verdict_uses() -> None:
    assert calibration_wording.REDUCED_CHI2_LIMIT == motion_fit.MAX_REDUCED_CHI2


@pytest.mark.parametrize(
    ("causes", "sentence"),
    [
        (["lost_samples"], "The findings name lost samples, which the fit does not include."),
        (
            ["lost_samples", "lost_samples"],
            "The findings name lost samples, which the fit does not include.",
        ),
        (["bias", "lost_samples"], "The findings also name lost samples, which the fit does not"),
        (["sign_flip"], "The gain includes a cause that the findings name: sign flip."),
        (
            ["sign_flip", "lost_samples"],
            "name: sign flip. The findings also name lost samples, which the fit does not",
        ),
        ([], "A search for further causes found none in the rates."),
    ],
)
def test_a_named_cause_that_is_not_in_the_fit_is_stated(
    causes: list[str], sentence: str, good_fit: GyroFit, provenance: Provenance
) -> None:
    """The checks of the samples name causes that no fit contains."""
    findings = FindingsReference(verdict="explained", causes=causes, file="f.yaml")
    document = msgspec.structs.replace(made(good_fit, provenance), findings=findings)
    assert document.trust.verdict == "good"
    assert sentence in calibration_summary(document)


def test_the_summary_shows_the_fitted_axes_of_a_cause_in_their_units(
    good_fit: GyroFit, provenance: Provenance
) -> None:
    document = made(good_fit, provenance)
    parameters = {
        **document.parameters,
        "backlash": Parameter(value=[0.0, 1.745e-3], std=[None, 1.0e-5], unit="rad"),
        "backlash.begin": Parameter(value=[-1.0, -0.9], std=[None, 0.05], unit="1"),
    }
    lines = calibration_summary(msgspec.structs.replace(document, parameters=parameters))
    rows = [line.split() for line in lines.splitlines() if line.lstrip().startswith("backlash")]
    assert rows == [
        ["backlash.tilt", "+0.09998", "±", "0.00057", "deg"],
        ["backlash.begin.tilt", "-0.900", "±", "0.050"],
    ]
