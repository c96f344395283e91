"""Test the truth side: no import of the solver, right sizes, sealed answers."""

import ast
import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.hidden.truth import make
from tests.hidden.truth.detectable import SIZES, compute_detectable, count_sizes
from tests.hidden.truth.draws import (
    LINES,
    PROGRAMS,
    SHARES,
    SIZED,
    Item,
    Session,
    choose_ladder_case,
    draw_session,
    find_shape_size,
    make_sizer,
)
from tests.hidden.truth.outside import SHAPES
from tests.hidden.truth.programs import read_program_text, reverse_steps
from tests.hidden.truth.session import ROOT, RigDraw, make_settings, record
from tests.hidden.truth.sizing import COUNTED, Sizer
from tests.support.noncentrality import detectable_noncentrality

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_daemon.emulator.injection import CAUSES
from gyrorig_daemon.emulator.rig_truth import sample_rig_truth
from gyrorig_daemon.session.emulation_options import estimate_session_s
from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.program import parse_program

RIG = RigDraw(77, "quick", 0.0, *LINES[3])
TRUTH = Path(__file__).parent / "truth"
SHARED = tuple(
    ROOT / "tests" / "support" / f"{name}.py" for name in ("noncentrality", "sealed_answer")
)


def list_imports(file: Path) -> set[str]:
    """Return the modules that a file imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    return names


def test_the_truth_does_not_import_the_solver() -> None:
    shared = tuple(f"tests.support.{file.stem}" for file in SHARED)
    allowed = ("gyrorig_daemon", "gyrorig_protocol", "tests.hidden.truth", *shared)
    for file in (*TRUTH.rglob("*.py"), *SHARED):
        for module in list_imports(file):
            inside = module.startswith(("gyrorig", "tests"))
            assert not inside or module.startswith(allowed) or module == "tests.hidden", (
                file,
                module,
            )


def test_the_solver_does_not_import_the_truth() -> None:
    for file in (ROOT / "solver").rglob("*.py"):
        assert not any(m.startswith(("gyrorig_daemon", "tests")) for m in list_imports(file)), file


def test_users_cannot_hide_a_shape_outside_the_catalogue() -> None:
    assert not SHAPES.keys() & CAUSES.keys()
    assert {shape.near for shape in SHAPES.values() if shape.near} <= CAUSES.keys()
    assert len([shape for shape in SHAPES.values() if shape.near is None]) >= 8
    assert sum(SHARES) == pytest.approx(1.0)
    assert sum(PROGRAMS.values()) == pytest.approx(1.0)
    shipped = {path.stem for path in (ROOT / "config" / "programs").glob("*.yaml")}
    assert shipped == {*PROGRAMS, "static"}


@pytest.mark.long
def test_the_same_seed_makes_the_same_bytes(tmp_path: Path) -> None:
    for name in ("first", "second"):
        session = draw_session(4, "nulls")
        assert session is not None
        make.make_case(tmp_path / name, replace(session, rig=replace(session.rig, program="quick")))
    first, second = ((tmp_path / name) for name in ("first", "second"))
    for name in ("answer.json", "sealed.txt", "recording.mcap"):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


@pytest.mark.long
def test_draws_depend_only_on_the_seed() -> None:
    first, again, other = (
        draw_session(300_003, "mixed"),
        draw_session(300_003, "mixed"),
        draw_session(300_004, "mixed"),
    )
    assert first == again
    assert first != other


def test_the_answer_is_sealed_and_not_in_the_recording(tmp_path: Path) -> None:
    item = Item(
        "backlash",
        "pan",
        5e-4,
        3.0,
        make_sizer(RIG).measure_visibility(InjectionRequest("backlash", "pan", 5e-4)),
    )
    sealed = make.make_case(tmp_path, Session("mixed", "one", RIG, (item,)))
    data = (tmp_path / "answer.json").read_bytes()
    assert (
        hashlib.sha256(data).hexdigest() == sealed == (tmp_path / "sealed.txt").read_text().strip()
    )
    assert b"backlash" not in (tmp_path / "recording.mcap").read_bytes()
    answer = json.loads(data)
    (cause,) = answer["causes"]
    assert cause["parameters"]["gap"] == {"value": 5e-4, "unit": "rad"}
    assert cause["times_detectable"] ** 2 * cause["detectable"] == pytest.approx(
        cause["noncentrality"]
    )
    begin_s, end_s = answer["span_s"]
    assert 10.0 < begin_s < end_s < begin_s + 60.0


@pytest.mark.long
def test_the_recorded_session_meets_its_rung(tmp_path: Path) -> None:
    # The calibration absorbs most of the effect. The rest depends on the sample times at the edges.
    sized = make_sizer(RIG).find_cause_size("s_curve", "", 2.0, 1.0)
    assert sized is not None
    item = Item("s_curve", "", sized.size, 2.0, sized.visibility)
    make.make_case(tmp_path, Session("ladder", "one", RIG, (item,), rung=2.0))
    answer = json.loads((tmp_path / "answer.json").read_text())
    (cause,) = answer["causes"]
    assert cause["times_detectable"] == pytest.approx(2.0, rel=0.03)
    with np.load(tmp_path / "rates.npz") as file:  # rates without noise
        assert np.any(file["GY80-1.hidden_rad_s"] != file["GY80-1.aligned_rad_s"])
    request = InjectionRequest("s_curve", "", cause["size"]["value"])
    course = record(replace(RIG, hide=(request,)), tmp_path / "again.mcap").course
    visibility = Sizer(make_settings(RIG), course).measure_visibility(request)
    assert visibility.noncentrality == pytest.approx(cause["noncentrality"], rel=1e-9)


@pytest.mark.parametrize("name", ["clock_step", "saturation"])
def test_a_size_is_as_visible_as_wanted(name: str) -> None:
    sized = make_sizer(RIG).find_cause_size(name, "", 3.0, 1.0)
    assert sized is not None
    assert sized.visibility.noncentrality == pytest.approx(9.0 * compute_detectable(name), rel=0.05)
    assert (
        make_sizer(RIG).measure_visibility(InjectionRequest(name, "", sized.size))
        == sized.visibility
    )


def test_an_effect_on_the_scatter_has_a_size() -> None:
    sizer = make_sizer(RIG)
    small, large = (sizer.find_cause_size("sample_jitter", "", k, 1.0) for k in (1.0, 2.0))
    assert small is not None
    assert large is not None
    assert large.size == pytest.approx(np.sqrt(2.0) * small.size, rel=0.02)


@pytest.mark.parametrize("name", sorted(SHAPES))
def test_every_shape_outside_the_catalogue_is_visible(name: str) -> None:
    rig = replace(RIG, soak_k=20.0) if SHAPES[name].needs_soak else RIG
    sized = find_shape_size(make_sizer(rig), SHAPES[name], rig, 3.0)
    assert sized is not None
    assert sized.visibility.noncentrality == pytest.approx(
        9.0 * detectable_noncentrality(), rel=0.05
    )


def test_a_ladder_has_all_causes_before_the_next_rung() -> None:
    cause_count = len(SIZED) + len(COUNTED)
    turns = [choose_ladder_case(number, 2) for number in range(4 * cause_count)]
    assert {name for name, _, _ in turns[:cause_count]} == {*SIZED, *COUNTED}
    assert [turns[k * cause_count][1:] for k in range(4)] == [
        (0, False),
        (1, False),
        (0, True),
        (1, True),
    ]
    assert len(set(turns)) == 4 * cause_count


def test_the_detectable_size_is_that_of_a_two_sided_test() -> None:
    assert compute_detectable("backlash") == pytest.approx(detectable_noncentrality(), rel=1e-6)
    assert compute_detectable("bias_step") == pytest.approx(24.80, abs=0.01)  # chi-square, 3
    assert (
        compute_detectable("g_sensitivity")
        > compute_detectable("eccentricity")
        > compute_detectable("worm_error")
    )
    assert set(SIZES) <= set(SIZED)


@pytest.mark.parametrize("name", sorted(SIZED))
def test_the_number_of_sizes_is_that_of_the_rig(name: str) -> None:
    shapes = {"at", "after", "lag", "time_constant", "frequency", "damping", "lag_at_power_up",
              "mean_lag"}  # fmt: skip
    request = InjectionRequest(name, "", CAUSES[name].typical)
    (hidden,) = sample_rig_truth(replace(make_settings(RIG), injections=(request,))).injected
    drawn_sizes = sum(
        np.size(parameter.value)
        for key, parameter in hidden.parameters.items()
        if key not in shapes
    )
    # Three of the nine numbers of the gravity matrix are not observable with one tilt axis.
    assert count_sizes(name) == drawn_sizes - (3 if name == "g_sensitivity" else 0)


@pytest.mark.parametrize("name", ["survey-40", "survey-130", "quick"])
def test_a_reversed_program_has_the_same_duration_and_reverses_back(name: str) -> None:
    steps = parse_yaml(read_program_text(name), name)["steps"]
    back = parse_program(read_program_text(f"{name}-backwards"), name)
    forth = parse_program(read_program_text(name), name)
    assert estimate_session_s(back) == pytest.approx(estimate_session_s(forth))
    assert reverse_steps(reverse_steps(steps)) == steps
