"""The truth side keeps its word: nothing of the solver in it, sizes that fit, sealed answers."""

import ast
import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.hidden.truth import make
from tests.hidden.truth.detectable import SIZES, detectable_of, sizes_of
from tests.hidden.truth.draws import (
    LINES,
    PROGRAMS,
    SHARES,
    SIZED,
    Item,
    Session,
    drawn,
    ladder_turn,
    shape_sized,
    sizer_of,
)
from tests.hidden.truth.outside import SHAPES
from tests.hidden.truth.programs import program_text, reversed_steps
from tests.hidden.truth.session import ROOT, RigDraw, record, settings_of
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


def imported(file: Path) -> set[str]:
    """Every module that a file names in an import."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    return names


def test_the_truth_imports_nothing_of_the_finder() -> None:
    shared = tuple(f"tests.support.{file.stem}" for file in SHARED)
    ours = ("gyrorig_daemon", "gyrorig_protocol", "tests.hidden.truth", *shared)
    for file in (*TRUTH.rglob("*.py"), *SHARED):
        for module in imported(file):
            inside = module.startswith(("gyrorig", "tests"))
            assert not inside or module.startswith(ours) or module == "tests.hidden", (file, module)


def test_the_finder_imports_nothing_of_the_truth() -> None:
    for file in (ROOT / "solver").rglob("*.py"):
        assert not any(m.startswith(("gyrorig_daemon", "tests")) for m in imported(file)), file


def test_no_order_of_a_user_reaches_what_is_outside_the_catalogue() -> None:
    assert not SHAPES.keys() & CAUSES.keys()
    assert {shape.near for shape in SHAPES.values() if shape.near} <= CAUSES.keys()
    assert len([shape for shape in SHAPES.values() if shape.near is None]) >= 8
    assert sum(SHARES) == pytest.approx(1.0)
    assert sum(PROGRAMS.values()) == pytest.approx(1.0)
    shipped = {path.stem for path in (ROOT / "config" / "programs").glob("*.yaml")}
    assert shipped == {*PROGRAMS, "static"}


def test_the_same_seed_makes_the_same_bytes(tmp_path: Path) -> None:
    for name in ("first", "second"):
        session = drawn(4, "nulls")
        assert session is not None
        make.make(tmp_path / name, replace(session, rig=replace(session.rig, program="quick")))
    first, second = ((tmp_path / name) for name in ("first", "second"))
    for name in ("answer.json", "sealed.txt", "recording.mcap"):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


def test_draws_depend_on_the_seed_alone() -> None:
    first, again, other = drawn(300_003, "mixed"), drawn(300_003, "mixed"), drawn(300_004, "mixed")
    assert first == again
    assert first != other


def test_the_answer_is_sealed_and_not_in_the_recording(tmp_path: Path) -> None:
    item = Item(
        "backlash",
        "pan",
        5e-4,
        3.0,
        sizer_of(RIG).visibility(InjectionRequest("backlash", "pan", 5e-4)),
    )
    sealed = make.make(tmp_path, Session("mixed", "one", RIG, (item,)))
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
def test_a_rung_is_met_by_the_session_that_comes_of_it(tmp_path: Path) -> None:
    # nearly all of it is absorbed: what is left hangs on how the samples fall on the edges
    sized = sizer_of(RIG).size_of_cause("s_curve", "", 2.0, 1.0)
    assert sized is not None
    item = Item("s_curve", "", sized.size, 2.0, sized.seen)
    make.make(tmp_path, Session("ladder", "one", RIG, (item,), rung=2.0))
    answer = json.loads((tmp_path / "answer.json").read_text())
    (cause,) = answer["causes"]
    assert cause["times_detectable"] == pytest.approx(2.0, rel=0.03)
    with np.load(tmp_path / "rates.npz") as file:  # what it would be without noise
        assert np.any(file["GY80-1.hidden_rad_s"] != file["GY80-1.aligned_rad_s"])
    order = InjectionRequest("s_curve", "", cause["size"]["value"])
    course = record(replace(RIG, hide=(order,)), tmp_path / "again.mcap").course
    seen = Sizer(settings_of(RIG), course).visibility(order)
    assert seen.noncentrality == pytest.approx(cause["noncentrality"], rel=1e-9)


@pytest.mark.parametrize("name", ["clock_step", "saturation"])
def test_a_size_is_as_visible_as_wanted(name: str) -> None:
    sized = sizer_of(RIG).size_of_cause(name, "", 3.0, 1.0)
    assert sized is not None
    assert sized.seen.noncentrality == pytest.approx(9.0 * detectable_of(name), rel=0.05)
    assert sizer_of(RIG).visibility(InjectionRequest(name, "", sized.size)) == sized.seen


def test_what_scatters_only_has_a_size_too() -> None:
    sizer = sizer_of(RIG)
    small, large = (sizer.size_of_cause("sample_jitter", "", k, 1.0) for k in (1.0, 2.0))
    assert small is not None
    assert large is not None
    assert large.size == pytest.approx(np.sqrt(2.0) * small.size, rel=0.02)


@pytest.mark.parametrize("name", sorted(SHAPES))
def test_every_shape_outside_the_catalogue_shows(name: str) -> None:
    rig = replace(RIG, soak_k=20.0) if SHAPES[name].needs_soak else RIG
    sized = shape_sized(sizer_of(rig), SHAPES[name], rig, 3.0)
    assert sized is not None
    assert sized.seen.noncentrality == pytest.approx(9.0 * detectable_noncentrality(), rel=0.05)


def test_a_ladder_goes_round_all_causes_before_the_next_rung() -> None:
    many = len(SIZED) + len(COUNTED)
    turns = [ladder_turn(number, 2) for number in range(4 * many)]
    assert {name for name, _, _ in turns[:many]} == {*SIZED, *COUNTED}
    assert [turns[k * many][1:] for k in range(4)] == [(0, False), (1, False), (0, True), (1, True)]
    assert len(set(turns)) == 4 * many


def test_one_size_is_found_as_a_two_sided_test_finds_it() -> None:
    assert detectable_of("backlash") == pytest.approx(detectable_noncentrality(), rel=1e-6)
    assert detectable_of("bias_step") == pytest.approx(24.80, abs=0.01)  # chi-square, 3
    assert (
        detectable_of("g_sensitivity") > detectable_of("eccentricity") > detectable_of("worm_error")
    )
    assert set(SIZES) <= set(SIZED)


@pytest.mark.parametrize("name", sorted(SIZED))
def test_sizes_are_counted_as_the_rig_draws_them(name: str) -> None:
    shapes = {"at", "after", "lag", "time_constant", "frequency", "damping", "lag_at_power_up",
              "mean_lag"}  # fmt: skip
    order = InjectionRequest(name, "", CAUSES[name].typical)
    (hidden,) = sample_rig_truth(replace(settings_of(RIG), injections=(order,))).injected
    drawn_sizes = sum(
        np.size(parameter.value)
        for key, parameter in hidden.parameters.items()
        if key not in shapes
    )
    # three of the nine of gravity's matrix never show: the stage tilts about one axis
    assert sizes_of(name) == drawn_sizes - (3 if name == "g_sensitivity" else 0)


@pytest.mark.parametrize("name", ["survey-40", "survey-130", "quick"])
def test_a_program_run_backwards_takes_as_long_and_back_again_is_itself(name: str) -> None:
    steps = parse_yaml(program_text(name), name)["steps"]
    back = parse_program(program_text(f"{name}-backwards"), name)
    forth = parse_program(program_text(name), name)
    assert estimate_session_s(back) == pytest.approx(estimate_session_s(forth))
    assert reversed_steps(reversed_steps(steps)) == steps
