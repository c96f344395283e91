"""A mistyped word is answered with the nearest words that are known."""

import pytest

from gyrorig_protocol.suggestions import closest_words, did_you_mean, list_closest

CAUSES = ("backlash", "base_compliance", "bias_ramp", "bias_step", "thermal_bias", "Tilt_Sag")


def test_the_nearest_word_comes_first() -> None:
    assert closest_words("backlsh", CAUSES)[0] == "backlash"
    assert closest_words("bias_stop", CAUSES)[0] == "bias_step"


def test_at_most_as_many_words_as_asked_for() -> None:
    assert len(closest_words("bias_", CAUSES, count=1)) == 1
    assert closest_words("bias_rstep", CAUSES, count=2) == ["bias_step", "bias_ramp"]


def test_case_does_not_matter_and_the_known_spelling_is_kept() -> None:
    assert closest_words("BACKLASH", CAUSES) == ["backlash"]
    assert closest_words("tilt_sag", CAUSES) == ["Tilt_Sag"]


def test_nothing_similar_gives_nothing() -> None:
    assert closest_words("xyz", CAUSES) == []
    assert closest_words("backlash", ()) == []
    assert closest_words("", CAUSES) == []


@pytest.mark.parametrize(
    ("previous", "text"),
    [
        ((), ""),
        (("scale",), "did you mean scale?"),
        (("scale", "scales"), "did you mean scale or scales?"),
        (("scale", "scales", "scale.x"), "did you mean scale, scales or scale.x?"),
    ],
)
def test_the_question_lists_all_suggestions(previous: tuple[str, ...], text: str) -> None:
    assert did_you_mean("scale", previous) == text


def test_a_list_has_at_most_three_words_and_the_number_of_others() -> None:
    boards = [f"C{k}" for k in range(1, 17)]
    assert list_closest("C17", boards) == "C7, C1, C16, or one of 13 others"
    assert list_closest("x", ["A", "B"]) == "A, B"
    assert list_closest("x", []) == ""
