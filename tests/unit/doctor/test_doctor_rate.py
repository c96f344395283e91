"""The sample rate of a board, for boards that send several samples per frame."""

import pytest

from gyrorig_daemon.doctor.board_check import BoardTraffic, _count_samples
from gyrorig_protocol.board import Batch, Sample


@pytest.mark.parametrize("count", [1, 8, 39])
def test_the_rate_does_not_depend_on_the_samples_per_frame(count: int) -> None:
    traffic = BoardTraffic()
    for k in range(100):
        frame = Batch(0, k * count, 0, ((0, 0, 0),) * count, None, 0)
        _count_samples(frame, 5.0 + k * count / 100.0, traffic)
    assert traffic.rate_hz == pytest.approx(100.0)


def test_a_slow_board_has_a_rate() -> None:
    traffic = BoardTraffic()
    for k in range(3):
        _count_samples(Sample(0, k, 0, (0, 0, 0), None, 0), float(k), traffic)
    assert traffic.rate_hz == pytest.approx(1.0)


def test_samples_that_come_together_have_no_rate() -> None:
    traffic = BoardTraffic()
    for k in range(20):
        _count_samples(Sample(0, k, 0, (0, 0, 0), None, 0), 5.0, traffic)
    assert traffic.rate_hz == 0.0
