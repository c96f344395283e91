"""Test the scorer of hidden effects: seals, outcomes, limits, figures, stored lines.

The cases are written by hand. The limits are compared with published values.
"""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.hidden.explain_cases import end_cut_line, read_rows
from tests.hidden.scoring import tables
from tests.hidden.scoring.answers import SCHEMAS, Answer, HiddenCause, SealError, open_answer
from tests.hidden.scoring.figures import Gap, compute_figures, count_confusions, find_missed_goals
from tests.hidden.scoring.kept import JudgedCases, read_judged_cases, write_judged_cases
from tests.hidden.scoring.outcome import Outcome, judge_case
from tests.hidden.scoring.picture import confusion_picture
from tests.hidden.scoring.possible import Bound, compute_largest_share
from tests.hidden.scoring.rigs import rigs_table
from tests.hidden.scoring.shares import Share
from tests.hidden.scoring.true_values import convert_true_values

LINE: dict[str, Any] = {
    "seed": 1, "verdict": "explained", "causes": [], "raw": [], "unexplained": [],
    "calibration": {"scale.x": [1.002, 0.001, 1.0]}, "absent": [["tilt_sag", None, 1e-3, "y", 9.0]],
    "not_testable": ["tilt_zero"], "harm_printed": True, "seconds": 1.5,
}  # fmt: skip

SIZES = {"gap": 0.001, "amplitude": 0.001, "phase": 0.0}


def make_answer(*causes: tuple[str, float], kind: str = "one", **changes: Any) -> Answer:
    hidden = tuple(HiddenCause(name, "tilt", t, t, SIZES) for name, t in causes)
    whole = Answer(
        seed=1, kind=kind, tier="ladder", program="survey-40", soak_k=0.0, decoy=None,
        causes=hidden, groups=(), allowed=(), near=None, calibration={"scale.x": 1.0},
        gain=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    )  # fmt: skip
    return replace(whole, **changes)


def make_entry(*names: str, gap: float = 0.001) -> dict[str, Any]:
    return {
        "set": list(names),
        "values": {"gap.tilt": [gap, 1e-4]},
        "sizes": ["gap.tilt"],
        "posterior": 1.0,
    }


def judge(sealed_answer: Answer, *causes: dict[str, Any], **line: Any) -> Outcome:
    return judge_case(sealed_answer, {**LINE, "causes": list(causes), **line})


def compute_figure(name: str, *outcomes: Outcome) -> float:
    return compute_figures(outcomes)[name].value


def test_limits_are_the_published_values() -> None:
    """Clopper and Pearson: upper limits 30.85 % for 0 of 10, 1.63 % (one-sided) for 4 of 560."""
    assert Share(0, 10).high == pytest.approx(0.30850, abs=1e-5)
    assert Share(10, 10).low == pytest.approx(1.0 - 0.30850, abs=1e-5)
    assert Share(5, 10).low == pytest.approx(0.18709, abs=1e-5)
    assert Share(4, 560).upper == pytest.approx(0.0163, abs=1e-4)
    assert (Share(0, 10).low, Share(10, 10).high, Share(10, 10).upper) == (0.0, 1.0, 1.0)


def test_a_sole_right_name_is_right() -> None:
    outcome = judge(make_answer(("backlash", 2.0)), make_entry("backlash"))
    assert compute_figure("sole_right", outcome) == 1.0
    assert compute_figure("wrong_names", outcome) == 0.0
    assert count_confusions([outcome], 2.0) == {"backlash": {"backlash": 1}}


def test_a_set_is_a_sole_name_only_if_its_members_are_one_effect() -> None:
    outcome = judge(make_answer(("backlash", 2.0)), make_entry("backlash", "base_compliance"))
    assert compute_figure("sole_right", outcome) == 0.0
    assert compute_figure("wrong_names", outcome) == 0.0
    twins = judge(make_answer(("tilt_sag", 2.0)), make_entry("tilt_sag", "eccentricity"))
    assert compute_figure("sole_right", twins) == 1.0


def test_a_right_name_with_a_wrong_name_is_not_right() -> None:
    outcome = judge(make_answer(("backlash", 2.0)), make_entry("backlash"), make_entry("ringing"))
    assert compute_figure("sole_right", outcome) == 0.0
    assert outcome.extra == (("ringing",),)
    assert compute_figure("wrong_names", outcome) == 0.0  # the true cause is stated


def test_a_wrong_name_counts_if_the_truth_is_not_stated() -> None:
    wrong = judge(make_answer(("backlash", 2.0)), make_entry("ringing"))
    small = judge(make_answer(("backlash", 1.0)), make_entry("ringing"))
    careful = judge(make_answer(("backlash", 2.0)), make_entry("ringing", "s_curve"))
    assert compute_figure("wrong_names", wrong, small, careful) == 1.0
    assert count_confusions([wrong], 2.0) == {"backlash": {"ringing": 1}}


def test_a_reported_fault_of_a_sound_stream_is_a_false_alarm() -> None:
    quiet = judge(make_answer(kind="null"))
    raw = judge(make_answer(kind="null"), raw=[{"set": ["repeated_samples"], "where": "all"}])
    rest = judge(make_answer(kind="null"), unexplained=["time"])
    assert compute_figure("false_alarms", quiet, raw, rest, quiet) == 0.5


def test_a_crash_is_a_wrong_answer() -> None:
    broken = judge_case(make_answer(kind="null"), {"seed": 1, "crashed": "ValueError: x"})
    assert broken.alarmed
    assert compute_figure("harm_printed", broken) == 0.0


def test_detection_counts_any_report() -> None:
    rest = judge(make_answer(("backlash", 1.0)), unexplained=["time"])
    nothing = judge(make_answer(("backlash", 1.0)))
    assert compute_figure("detected_once", rest, nothing) == 0.5


def test_a_shape_outside_needs_the_right_covariate_first_and_no_name() -> None:
    outside = make_answer(("outside:dip", 3.0), kind="outside", groups=("own_rate", "speed"))
    right = judge(outside, unexplained=["speed", "time"])
    late = judge(outside, unexplained=["time", "speed"])
    wrong = judge(outside, make_entry("scale_cubic"))
    assert compute_figure("outside_group", right, late) == 0.5
    assert compute_figure("outside_wrong", right, late, wrong) == pytest.approx(1 / 3)


def test_a_shape_may_have_the_name_of_its_similar_cause() -> None:
    nearly = make_answer(("nearly:soft", 3.0), kind="nearly", near="backlash")
    assert compute_figure("nearly_wrong", judge(nearly, make_entry("backlash"))) == 0.0
    assert compute_figure("nearly_wrong", judge(nearly, make_entry("ringing"))) == 1.0


def test_many_causes_are_counted_by_stated_sets() -> None:
    many = make_answer(("backlash", 5.0), ("ringing", 4.0), ("tilt_sag", 0.5), kind="many")
    outcome = judge(
        many, make_entry("backlash"), make_entry("s_curve", "ringing"), make_entry("worm_error")
    )
    assert compute_figure("recall", outcome) == 1.0  # the third cause is not detectable
    assert compute_figure("precision", outcome) == pytest.approx(2 / 3)
    assert compute_figure("recall", judge(many, make_entry("ringing"))) == 0.5


def test_a_whole_rig_has_separate_figures() -> None:
    rig = make_answer(("backlash", 5.0), ("ringing", 4.0), kind="rig")
    names = (make_entry("backlash"), make_entry("worm_error"))
    near = judge(rig, *names, total_std={"scale.x": 0.0005, "bias.x": 1e-9})
    far = judge(rig, *names, total_std={"scale.x": 0.0004})
    assert [near.gain_sigma, far.gain_sigma] == pytest.approx([4.0, 5.0])
    assert compute_figure("rig_recall", near) == compute_figure("rig_precision", near) == 0.5
    assert compute_figure("rig_gain", replace(near, gain_sigma=3.99), far) == 0.5
    assert compute_figure("rig_gain", judge(rig, *names)) == 0.0  # nothing stated
    assert compute_figures([near])["recall"].words == "none tried"
    assert "| `backlash` | 5.0x (5.0x to 5.0x) | 1 of 1" in rigs_table([near])


def test_intervals_are_compared_with_the_truth_after_selection() -> None:
    near = judge(make_answer(("backlash", 2.0)), make_entry("backlash", gap=0.00115))
    far = judge(make_answer(("backlash", 2.0)), make_entry("backlash", gap=0.0013))
    assert compute_figure("covered_causes", near, far) == 0.5
    # The error of the calibration is two standard deviations.
    assert compute_figure("covered_calibration", near) == 0.0
    outside = judge(make_answer(("outside:dip", 3.0), kind="outside"))
    assert compute_figures([outside])["covered_calibration"].words == "none tried"


def test_the_cost_of_estimation_is_allowed() -> None:
    gaps = [Gap(1, 200.0, 6.0, 10), Gap(2, 90.0, 5.0, 10), Gap(3, 90.0, 9.0, 10)]
    assert compute_figures([], gaps)["gap"].value == pytest.approx(0.0)
    assert [goal.name for goal in find_missed_goals(compute_figures([], gaps))] == []
    worse = [replace(gap, short=gap.short + 0.5) for gap in gaps]
    assert [goal.name for goal in find_missed_goals(compute_figures([], worse))] == ["gap"]


def test_phases_are_compared_as_sine_and_cosine() -> None:
    values = dict(convert_true_values("worm_error", "pan", {"amplitude": 2.0, "phase": 0.0}))
    assert values == {"cosine.pan": 0.0, "sine.pan": 2.0}
    assert dict(convert_true_values("board_slip", "all", {"turn.x": 0.5}))["turn.x"] == -0.5
    assert not dict(convert_true_values("corrupt_samples", None, {"share": 0.1}))


def _make_case_folder(folder: Path) -> str:
    folder.mkdir()
    board = {
        "STM": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        "mean_bias_rad_s": [0.1, 0.2, 0.3], "time_offset_s": 0.01,
    }  # fmt: skip
    step = {"value": [1, 2, 3], "unit": "rad/s"}
    cause = {
        "cause": "bias_step", "place": "x,y,z", "times_detectable": 2.0,
        "beside_others": None, "parameters": {"step": step},
    }  # fmt: skip
    document = {
        "schema": SCHEMAS[1], "seed": int(folder.name), "tier": "mixed", "kind": "one",
        "program": "quick", "soak_k": 0.0, "detectable": 20.0, "causes": [cause],
        "truth": {"boards": {"GY80-1": board}},
    }  # fmt: skip
    (folder / "answer.json").write_text(json.dumps(document))
    return hashlib.sha256((folder / "answer.json").read_bytes()).hexdigest()


def test_an_answer_opens_only_with_its_seal(tmp_path: Path) -> None:
    seal = _make_case_folder(tmp_path / "12")
    opened_answer = open_answer(tmp_path / "12", seal)
    assert opened_answer.causes[0].parameters == {"step.x": 1.0, "step.y": 2.0, "step.z": 3.0}
    assert opened_answer.calibration["bias.y"] == 0.2
    path = tmp_path / "12" / "answer.json"
    path.write_text(path.read_text().replace("bias_step", "bias_ramp"))
    with pytest.raises(SealError):
        open_answer(tmp_path / "12", seal)


def test_an_incomplete_line_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text('{"seed": 3, "verdict": "adequate"}\n{"seed": 4, "verd')
    end_cut_line(path)
    with path.open("a") as file:
        file.write('{"seed": 5}\n')
    assert list(read_rows(path)) == [3, 5]


def test_stored_results_give_the_same_figures(tmp_path: Path) -> None:
    sealed_answer = make_answer(("backlash", 2.0))
    judged_cases = JudgedCases(
        [judge(sealed_answer, make_entry("backlash")), judge(sealed_answer, make_entry("ringing"))],
        [],
    )
    write_judged_cases(tmp_path / "kept.json", judged_cases)
    again = read_judged_cases(tmp_path / "kept.json")
    before, after = compute_figures(judged_cases.outcomes), compute_figures(again.outcomes)
    assert {k: v.words for k, v in before.items()} == {k: v.words for k, v in after.items()}
    picture = confusion_picture(again.outcomes)
    assert "backlash: 1 of 2 called ringing" in picture


def make_bound(left: float, seed: int = 1, times: float = 2.0) -> Bound:
    lambda_ = times**2 * 20.0
    return Bound(seed, "scale_asymmetry", times, False, "scale_quadratic", left, left * lambda_)


def test_the_bound_grows_with_the_residual_of_the_best_rival() -> None:
    # non-centrality 80: the lead is 40 - 2.94 nats, with a standard deviation of 8.94
    assert make_bound(1.0).chance == pytest.approx(0.99998, abs=2e-5)
    # no difference: the lead is never ln 19
    assert make_bound(0.0).chance == 0.0
    # non-centrality 2 ln 19: the lead is sufficient in half of all cases
    assert make_bound(2.0 * np.log(19.0) / 80.0).chance == pytest.approx(0.5)
    assert compute_largest_share([make_bound(1.0), make_bound(0.0)]) == pytest.approx(0.5, abs=1e-3)
    assert np.isnan(compute_largest_share([]))


def test_the_bound_is_stated_with_the_figure_and_stored(tmp_path: Path) -> None:
    sealed_answer = make_answer(("scale_asymmetry", 2.0))
    judged_cases = JudgedCases(
        [judge(sealed_answer, make_entry("scale_asymmetry"))],
        [],
        [make_bound(0.0, sealed_answer.seed)],
    )
    figure = compute_figures(judged_cases.outcomes, (), judged_cases.bounds)["sole_right"]
    assert figure.words.endswith("upper bound 0.0 %")
    write_judged_cases(tmp_path / "kept.json", judged_cases)
    assert read_judged_cases(tmp_path / "kept.json").bounds == judged_cases.bounds
    assert "`scale_quadratic`" in tables.inseparable(judged_cases.bounds)
    assert tables.inseparable([]) == "Not measured."
