"""The capture clock: reading the clocks of the host leaves nothing behind."""

import gc

from gyrorig_daemon.clocks.capture_clock import read_host_clocks


def test_reading_the_clocks_leaves_no_reference_cycle() -> None:
    """The service reads them twice per second for months and rarely collects cycles."""
    read_host_clocks()
    gc.collect()
    gc.disable()
    try:
        for _ in range(20):
            read_host_clocks()
        assert gc.collect() == 0
    finally:
        gc.enable()
