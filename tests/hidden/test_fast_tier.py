"""The fast tier has the sessions that its goals need. test_whole_fast_tier.py explains them."""

from tests.hidden.fast import read_sessions

NULLS = [line for line in read_sessions() if line["kind"] == "null"]
CAUSES = [line for line in read_sessions() if line["kind"] == "one"]


def test_every_cause_with_a_size_is_in_the_tier() -> None:
    assert len(NULLS) == 20
    assert len({line["cause"] for line in CAUSES}) == len(CAUSES) >= 30
    # Lost steps are a whole number, so one step may be larger than the wanted size.
    assert all(line["times"] is None or line["times"] > 2.9 for line in CAUSES)
