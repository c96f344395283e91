"""The capture clock: reading the clocks of the host, also where the kernel denies a part of it."""

import ctypes
import gc
import math
from pathlib import Path

import pytest

from gyrorig_daemon.clocks import capture_clock
from gyrorig_daemon.clocks.capture_clock import STA_UNSYNC, read_host_clocks
from gyrorig_daemon.service.service_process import _valid_utc_s
from gyrorig_daemon.service.system_clock_monitor import SystemClockMonitor


class DenyingLibrary:
    """The C library under `ProtectClock=yes`, where the system call fails with EPERM."""

    def adjtimex(self, _: object) -> int:
        return -1


@pytest.mark.parametrize("is_set", [False, True], ids=["unknown", "set by timesyncd"])
def test_a_denied_system_call_is_no_synchronised_clock(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, is_set: bool
) -> None:
    path = tmp_path / "synchronized"
    monkeypatch.setattr(capture_clock, "SYNCHRONISED_FILE", path)
    monkeypatch.setattr(capture_clock, "_libc", DenyingLibrary)
    if is_set:
        path.touch()
    clocks = read_host_clocks()
    assert clocks.ntp_status == (0 if is_set else STA_UNSYNC)
    assert math.isnan(clocks.frequency_ppm)
    monitor = SystemClockMonitor(read_host_clocks, 0, print)
    monitor.fire(0)
    assert monitor.is_synchronised is (True if is_set else None)
    assert (_valid_utc_s() is None) == (not is_set)


def test_the_kernel_decides_where_it_answers(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class Library:
        def adjtimex(self, words: object) -> int:
            ctypes.cast(words, ctypes.POINTER(ctypes.c_long))[5] = STA_UNSYNC  # type: ignore[arg-type]
            return 5  # TIME_ERROR

    path = tmp_path / "synchronized"
    path.touch()
    monkeypatch.setattr(capture_clock, "SYNCHRONISED_FILE", path)
    monkeypatch.setattr(capture_clock, "_libc", Library)
    assert read_host_clocks().is_synchronised is False
    assert _valid_utc_s() is None


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
