"""The judge of hidden effects: seals, outcomes, limits, figures, kept lines.

The judge is judged by cases made by hand, the limits by published values.
"""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.hidden.explain_cases import end_cut_line, results_of
from tests.hidden.scoring import tables
from tests.hidden.scoring.answers import SCHEMAS, Answer, HiddenCause, SealError, opened
from tests.hidden.scoring.figures import Gap, confusion, figures, missed
from tests.hidden.scoring.kept import JudgedCases, read_judged_cases, write_judged_cases
from tests.hidden.scoring.outcome import Outcome, outcome_of
from tests.hidden.scoring.picture import confusion_picture
from tests.hidden.scoring.possible import Bound, possible
from tests.hidden.scoring.rigs import rigs_table
from tests.hidden.scoring.shares import Share
from tests.hidden.scoring.true_values import true_values

LINE: dict[str, Any] = {
    "seed": 1, "verdict": "explained", "causes": [], "raw": [], "unexplained": [],
    "calibration": {"scale.x": [1.002, 0.001, 1.0]}, "absent": [["tilt_sag", None, 1e-3, "y", 9.0]],
    "not_testable": ["tilt_zero"], "harm_printed": True, "seconds": 1.5,
}  # fmt: skip

SIZES = {"gap": 0.001, "amplitude": 0.001, "phase": 0.0}


def answer(*causes: tuple[str, float], kind: str = "one", **changes: Any) -> Answer:
    hidden = tuple(HiddenCause(name, "tilt", t, t, SIZES) for name, t in causes)
    whole = Answer(
        seed=1, kind=kind, tier="ladder", program="survey-40", soak_k=0.0, decoy=None,
        causes=hidden, groups=(), allowed=(), near=None, calibration={"scale.x": 1.0},
        gain=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    )  # fmt: skip
    return replace(whole, **changes)


def named(*names: str, gap: float = 0.001) -> dict[str, Any]:
    return {
        "set": list(names),
        "values": {"gap.tilt": [gap, 1e-4]},
        "sizes": ["gap.tilt"],
        "posterior": 1.0,
    }


def judged(sealed_answer: Answer, *causes: dict[str, Any], **line: Any) -> Outcome:
    return outcome_of(sealed_answer, {**LINE, "causes": list(causes), **line})


def figure(name: str, *outcomes: Outcome) -> float:
    return figures(outcomes)[name].value


def test_limits_are_the_published_ones() -> None:
    """Clopper and Pearson: 0 of 10 has an upper limit of 30.85 %; 4 of 560, one-sided, 1.63 %."""
    assert Share(0, 10).high == pytest.approx(0.30850, abs=1e-5)
    assert Share(10, 10).low == pytest.approx(1.0 - 0.30850, abs=1e-5)
    assert Share(5, 10).low == pytest.approx(0.18709, abs=1e-5)
    assert Share(4, 560).upper == pytest.approx(0.0163, abs=1e-4)
    assert (Share(0, 10).low, Share(10, 10).high, Share(10, 10).upper) == (0.0, 1.0, 1.0)


def test_a_right_name_alone_is_right() -> None:
    outcome = judged(answer(("backlash", 2.0)), named("backlash"))
    assert figure("sole_right", outcome) == 1.0
    assert figure("wrong_names", outcome) == 0.0
    assert confusion([outcome], 2.0) == {"backlash": {"backlash": 1}}


def test_a_set_is_no_sole_name_unless_its_members_are_one_effect() -> None:
    outcome = judged(answer(("backlash", 2.0)), named("backlash", "base_compliance"))
    assert figure("sole_right", outcome) == 0.0
    assert figure("wrong_names", outcome) == 0.0
    twins = judged(answer(("tilt_sag", 2.0)), named("tilt_sag", "eccentricity"))
    assert figure("sole_right", twins) == 1.0


def test_a_wrong_name_beside_the_right_one_is_not_right() -> None:
    outcome = judged(answer(("backlash", 2.0)), named("backlash"), named("ringing"))
    assert figure("sole_right", outcome) == 0.0
    assert outcome.extra == (("ringing",),)
    assert figure("wrong_names", outcome) == 0.0  # the truth was stated


def test_a_wrong_name_counts_where_the_truth_is_not_stated() -> None:
    wrong = judged(answer(("backlash", 2.0)), named("ringing"))
    small = judged(answer(("backlash", 1.0)), named("ringing"))
    careful = judged(answer(("backlash", 2.0)), named("ringing", "s_curve"))
    assert figure("wrong_names", wrong, small, careful) == 1.0
    assert confusion([wrong], 2.0) == {"backlash": {"ringing": 1}}


def test_a_stream_s_fault_named_for_nothing_is_a_false_alarm() -> None:
    quiet = judged(answer(kind="null"))
    raw = judged(answer(kind="null"), raw=[{"set": ["repeated_samples"], "where": "all"}])
    rest = judged(answer(kind="null"), unexplained=["time"])
    assert figure("false_alarms", quiet, raw, rest, quiet) == 0.5


def test_a_crash_is_a_wrong_answer() -> None:
    broken = outcome_of(answer(kind="null"), {"seed": 1, "crashed": "ValueError: x"})
    assert broken.alarmed
    assert figure("harm_printed", broken) == 0.0


def test_detection_counts_whatever_was_said() -> None:
    rest = judged(answer(("backlash", 1.0)), unexplained=["time"])
    nothing = judged(answer(("backlash", 1.0)))
    assert figure("detected_once", rest, nothing) == 0.5


def test_outside_needs_the_right_group_first_and_no_name() -> None:
    outside = answer(("outside:dip", 3.0), kind="outside", groups=("own_rate", "speed"))
    right = judged(outside, unexplained=["speed", "time"])
    late = judged(outside, unexplained=["time", "speed"])
    wrong = judged(outside, named("scale_cubic"))
    assert figure("outside_group", right, late) == 0.5
    assert figure("outside_wrong", right, late, wrong) == pytest.approx(1 / 3)


def test_a_shape_may_be_called_by_the_entry_that_it_is_near_to() -> None:
    nearly = answer(("nearly:soft", 3.0), kind="nearly", near="backlash")
    assert figure("nearly_wrong", judged(nearly, named("backlash"))) == 0.0
    assert figure("nearly_wrong", judged(nearly, named("ringing"))) == 1.0


def test_many_are_counted_by_stated_sets() -> None:
    many = answer(("backlash", 5.0), ("ringing", 4.0), ("tilt_sag", 0.5), kind="many")
    outcome = judged(many, named("backlash"), named("s_curve", "ringing"), named("worm_error"))
    assert figure("recall", outcome) == 1.0  # the third cannot be seen
    assert figure("precision", outcome) == pytest.approx(2 / 3)
    assert figure("recall", judged(many, named("ringing"))) == 0.5


def test_a_whole_rig_has_figures_of_its_own() -> None:
    rig = answer(("backlash", 5.0), ("ringing", 4.0), kind="rig")
    names = (named("backlash"), named("worm_error"))
    near = judged(rig, *names, total_std={"scale.x": 0.0005, "bias.x": 1e-9})
    far = judged(rig, *names, total_std={"scale.x": 0.0004})
    assert [near.gain_sigma, far.gain_sigma] == pytest.approx([4.0, 5.0])
    assert figure("rig_recall", near) == figure("rig_precision", near) == 0.5
    assert figure("rig_gain", replace(near, gain_sigma=3.99), far) == 0.5
    assert figure("rig_gain", judged(rig, *names)) == 0.0  # nothing stated
    assert figures([near])["recall"].words == "none tried"
    assert "| `backlash` | 5.0x (5.0x to 5.0x) | 1 of 1" in rigs_table([near])


def test_intervals_are_held_against_truth_after_selection() -> None:
    near = judged(answer(("backlash", 2.0)), named("backlash", gap=0.00115))
    far = judged(answer(("backlash", 2.0)), named("backlash", gap=0.0013))
    assert figure("covered_causes", near, far) == 0.5
    assert figure("covered_calibration", near) == 0.0  # two deviations off
    outside = judged(answer(("outside:dip", 3.0), kind="outside"))
    assert figures([outside])["covered_calibration"].words == "none tried"


def test_what_estimating_costs_is_allowed() -> None:
    gaps = [Gap(1, 200.0, 6.0, 10), Gap(2, 90.0, 5.0, 10), Gap(3, 90.0, 9.0, 10)]
    assert figures([], gaps)["gap"].value == pytest.approx(0.0)
    assert [goal.name for goal in missed(figures([], gaps))] == []
    worse = [replace(gap, short=gap.short + 0.5) for gap in gaps]
    assert [goal.name for goal in missed(figures([], worse))] == ["gap"]


def test_phases_are_compared_by_their_parts() -> None:
    values = dict(true_values("worm_error", "pan", {"amplitude": 2.0, "phase": 0.0}))
    assert values == {"cosine.pan": 0.0, "sine.pan": 2.0}
    assert dict(true_values("board_slip", "all", {"turn.x": 0.5}))["turn.x"] == -0.5
    assert not dict(true_values("corrupt_samples", None, {"share": 0.1}))


def _case(folder: Path) -> str:
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


def test_an_answer_opens_by_its_seal_only(tmp_path: Path) -> None:
    seal = _case(tmp_path / "12")
    opened_answer = opened(tmp_path / "12", seal)
    assert opened_answer.causes[0].parameters == {"step.x": 1.0, "step.y": 2.0, "step.z": 3.0}
    assert opened_answer.calibration["bias.y"] == 0.2
    path = tmp_path / "12" / "answer.json"
    path.write_text(path.read_text().replace("bias_step", "bias_ramp"))
    with pytest.raises(SealError):
        opened(tmp_path / "12", seal)


def test_a_line_cut_off_by_a_stop_is_done_again(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text('{"seed": 3, "verdict": "adequate"}\n{"seed": 4, "verd')
    end_cut_line(path)
    with path.open("a") as file:
        file.write('{"seed": 5}\n')
    assert list(results_of(path)) == [3, 5]


def test_what_is_kept_gives_the_same_figures(tmp_path: Path) -> None:
    sealed_answer = answer(("backlash", 2.0))
    judged_cases = JudgedCases(
        [judged(sealed_answer, named("backlash")), judged(sealed_answer, named("ringing"))], []
    )
    write_judged_cases(tmp_path / "kept.json", judged_cases)
    again = read_judged_cases(tmp_path / "kept.json")
    before, after = figures(judged_cases.outcomes), figures(again.outcomes)
    assert {k: v.words for k, v in before.items()} == {k: v.words for k, v in after.items()}
    picture = confusion_picture(again.outcomes)
    assert "backlash: 1 of 2 called ringing" in picture


def bound(left: float, seed: int = 1, times: float = 2.0) -> Bound:
    lambda_ = times**2 * 20.0
    return Bound(seed, "scale_asymmetry", times, False, "scale_quadratic", left, left * lambda_)


def test_what_the_data_bear_goes_with_what_the_best_rival_leaves() -> None:
    # 80 of non-centrality: 40 - 2.94 nats ahead, of a deviation of 8.94
    assert bound(1.0).chance == pytest.approx(0.99998, abs=2e-5)
    # no difference: never ahead by ln 19
    assert bound(0.0).chance == 0.0
    # a rest of 2 ln 19: ahead by enough in half of all cases
    assert bound(2.0 * np.log(19.0) / 80.0).chance == pytest.approx(0.5)
    assert possible([bound(1.0), bound(0.0)]) == pytest.approx(0.5, abs=1e-3)
    assert np.isnan(possible([]))


def test_the_bound_is_said_beside_the_figure_and_kept(tmp_path: Path) -> None:
    sealed_answer = answer(("scale_asymmetry", 2.0))
    judged_cases = JudgedCases(
        [judged(sealed_answer, named("scale_asymmetry"))], [], [bound(0.0, sealed_answer.seed)]
    )
    figure = figures(judged_cases.outcomes, (), judged_cases.bounds)["sole_right"]
    assert figure.words.endswith("upper bound 0.0 %")
    write_judged_cases(tmp_path / "kept.json", judged_cases)
    assert read_judged_cases(tmp_path / "kept.json").bounds == judged_cases.bounds
    assert "`scale_quadratic`" in tables.inseparable(judged_cases.bounds)
    assert tables.inseparable([]) == "Not measured."
