"""Findings of the doctor about a computer whose system files are in a folder."""

import errno
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from gyrorig_daemon.clocks.capture_clock import STA_UNSYNC, HostClocks
from gyrorig_daemon.config.service_settings import ScheduleEntry, ServiceSettings
from gyrorig_daemon.doctor import disk_check, port_check
from gyrorig_daemon.doctor.capacity_forecast import (
    RecordingLoad,
    check_capacity,
    check_schedule_can_run,
)
from gyrorig_daemon.doctor.clock_check import check_clocks
from gyrorig_daemon.doctor.computer_check import check_computer
from gyrorig_daemon.doctor.disk_check import DiskMeasurement, check_disk
from gyrorig_daemon.doctor.finding import EXIT_CODES, Finding, Level, worst
from gyrorig_daemon.doctor.port_check import check_port
from gyrorig_daemon.doctor.system_files import SystemFiles
from gyrorig_daemon.links.ports.port_holder import PortHolder

NOW_NS = 1_795_000_000 * 10**9  # November 2026
GOOD = HostClocks(1, 1, NOW_NS, 3.0, 0.001, 0x2001)


@pytest.fixture
def system(tmp_path: Path) -> SystemFiles:
    """A healthy Raspberry Pi with the service installed and chrony at work."""
    (tmp_path / "root").mkdir()
    shown = SystemFiles(tmp_path / "root")
    put(shown, "/proc/meminfo", "MemTotal: 3884300 kB\nMemAvailable: 3000000 kB\n")
    put(shown, "/proc/loadavg", "0.10 0.20 0.30 1/200 4711")
    put(shown, "/proc/812/comm", "chronyd")
    put(shown, "/proc/mounts", f"/dev/mmcblk0p2 {tmp_path} ext4 rw,noatime 0 0\n")
    put(shown, "/sys/class/thermal/thermal_zone0/temp", "48300")
    put(shown, "/sys/class/rtc/rtc0/name", "rpi_rtc")
    put(shown, "/etc/systemd/system/multi-user.target.wants/gyrorigd.service", "")
    return shown


def put(system: SystemFiles, name: str, text: str) -> None:
    path = system.path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def codes(findings: Iterable[Finding], least: Level = Level.NOTE) -> list[str]:
    return [finding.code for finding in findings if finding.level >= least]


def test_nothing_to_do(system: SystemFiles) -> None:
    findings = [*check_computer(system), *check_clocks(system, GOOD)]
    assert codes(findings) == []
    assert EXIT_CODES[worst(findings)] == 0
    assert all(finding.what for finding in findings)


@pytest.mark.parametrize(
    ("name", "text", "code", "level"),
    [
        ("/sys/class/thermal/thermal_zone1/temp", "84000", "hot", Level.WARNING),
        ("/proc/meminfo", "MemAvailable: 90000 kB\n", "memory", Level.WARNING),
        ("/proc/loadavg", "9 900.5 700 1/2 3", "load", Level.WARNING),
        (
            "/etc/apt/apt.conf.d/50unattended-upgrades",
            '// Unattended-Upgrade::Automatic-Reboot "false";\n'
            'Unattended-Upgrade::Automatic-Reboot "true";\n',
            "reboots",
            Level.WARNING,
        ),
    ],
)
def test_a_computer_with_a_flaw(
    system: SystemFiles, name: str, text: str, code: str, level: Level
) -> None:
    put(system, name, text)
    (finding,) = [f for f in check_computer(system) if f.level > Level.OK]
    assert (finding.code, finding.level) == (code, level)
    assert finding.remedy


def cpuinfo(flags: str) -> str:
    core = f"processor\t: {{}}\nmodel name\t: some\nflags\t\t: {flags}\nbugs\t\t: spectre_v1\n"
    return "\n".join(core.format(number) for number in range(2))


# The first is what /proc/cpuinfo says of qemu's default processor (qemu64).
@pytest.mark.parametrize(
    ("text", "missing"),
    [
        (
            cpuinfo("fpu sse sse2 syscall nx lm rep_good nopl pni cx16 hypervisor lahf_lm"),
            "popcnt, sse4_1, sse4_2, ssse3",
        ),
        (cpuinfo("fpu sse2 lm pni ssse3 cx16 sse4_1 sse4_2 lahf_lm"), "popcnt"),
        (cpuinfo("fpu sse2 lm pni ssse3 cx16 sse4_1 sse4_2 popcnt lahf_lm avx2"), ""),
        (cpuinfo("fpu sse sse2 pni"), ""),  # of 32 bits: no such wheels, and other news
        ("processor\t: 0\nFeatures\t: fp asimd evtstrm crc32 cpuid\n", ""),  # a Raspberry Pi
        ("", ""),
    ],
    ids=["qemu64", "one flag", "v2", "32 bits", "arm", "nothing"],
)
def test_a_processor_on_which_numpy_does_not_start(
    system: SystemFiles, text: str, missing: str
) -> None:
    put(system, "/proc/cpuinfo", text)
    findings = [f for f in check_computer(system) if f.level > Level.OK]
    assert [f.code for f in findings] == ["processor"] * bool(missing)
    for finding in findings:
        assert finding.level is Level.FAULT
        assert f"lacks the instructions {missing}. " in finding.what
        assert "-cpu host" in finding.remedy


def test_the_pi_s_own_alarm_of_its_supply(system: SystemFiles) -> None:
    put(system, "/sys/class/hwmon/hwmon3/name", "rpi_volt")
    put(system, "/sys/class/hwmon/hwmon3/in0_lcrit_alarm", "0")
    assert codes(check_computer(system)) == []
    put(system, "/sys/class/hwmon/hwmon3/in0_lcrit_alarm", "1")
    assert codes(check_computer(system)) == ["undervoltage"]


def test_nothing_starts_the_daemon(system: SystemFiles) -> None:
    wanted = system.path("/etc/systemd/system/multi-user.target.wants/gyrorigd.service")
    wanted.unlink()
    (finding,) = [f for f in check_computer(system) if f.level > Level.OK]
    assert (finding.code, finding.remedy) == ("service", "run `sudo make install-service`")
    put(system, "/etc/systemd/system/gyrorigd.service", "")
    (finding,) = [f for f in check_computer(system) if f.level > Level.OK]
    assert finding.remedy.startswith("run `systemctl enable")


def test_clocks(system: SystemFiles) -> None:
    unsynchronised = replace(GOOD, ntp_status=STA_UNSYNC)
    (finding,) = [f for f in check_clocks(system, unsynchronised) if f.level]
    assert finding.code == "not_synchronised"
    assert "chronyd runs" in finding.what
    put(system, "/proc/812/comm", "bash")
    (finding,) = [f for f in check_clocks(system, unsynchronised) if f.level]
    assert finding.remedy == "install the program chrony"
    assert codes(check_clocks(system, replace(GOOD, realtime_ns=3 * 10**9))) == ["wrong_date"]
    assert codes(check_clocks(system, replace(GOOD, estimated_error_s=16.0))) == [
        "not_synchronised"
    ]
    # no such call (a container without it): nothing is said that is not known
    unknown = replace(GOOD, frequency_ppm=float("nan"), estimated_error_s=float("nan"))
    assert codes(check_clocks(system, unknown)) == []
    denied = replace(unknown, ntp_status=STA_UNSYNC)
    (finding,) = check_clocks(system, denied)
    assert (finding.level, finding.code) == (Level.NOTE, "synchronisation_unknown")
    put(system, "/sys/devices/system/clocksource/clocksource0/current_clocksource", "jiffies")
    assert codes(check_clocks(system, GOOD)) == ["slow_clock"]
    (system.path("/sys/class/rtc/rtc0/name")).unlink()
    system.path("/sys/class/rtc/rtc0").rmdir()
    assert codes(check_clocks(system, GOOD)) == ["no_rtc", "slow_clock"]


def test_a_disk_is_measured_and_left_as_it_was(system: SystemFiles, tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    recordings.mkdir()
    (recordings / "a.mcap").write_bytes(b"a")
    findings, measured = check_disk(recordings / "not" / "there", system)
    assert measured is not None
    assert measured.folder == recordings
    assert measured.free_bytes > 0
    assert measured.write_bytes_s > 0.0
    assert [finding.subject for finding in findings] == ["disk"]
    assert [path.name for path in recordings.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize(
    ("spent_s", "code", "level"),
    [(0.004, "speed", Level.OK), (0.3, "slow", Level.WARNING), (1.5, "too_slow", Level.FAULT)],
)
def test_how_slow_a_disk_is(
    system: SystemFiles,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    spent_s: float,
    code: str,
    level: Level,
) -> None:
    monkeypatch.setattr(disk_check, "_timed_write", lambda _: spent_s)
    findings, _ = check_disk(tmp_path, system)
    assert [(finding.code, finding.level) for finding in findings] == [(code, level)]


@pytest.mark.parametrize(
    ("mount", "code", "level"),
    [
        ("vfat rw", "no_journal", Level.WARNING),
        ("tmpfs rw,size=1g", "not_kept", Level.NOTE),
        ("ext4 ro,noatime", "read_only", Level.FAULT),
    ],
)
def test_kinds_of_disks(
    system: SystemFiles,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    mount: str,
    code: str,
    level: Level,
) -> None:
    monkeypatch.setattr(disk_check, "_timed_write", lambda _: 0.001)
    put(system, "/proc/mounts", f"/dev/a / ext4 rw 0 0\n/dev/b {tmp_path} {mount} 0 0\n")
    findings, measured = check_disk(tmp_path, system)
    assert [(f.code, f.level) for f in findings if f.level] == [(code, level)]
    assert (measured is None) == (level is Level.FAULT)


def test_a_disk_that_takes_nothing(
    system: SystemFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: Path) -> float:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(disk_check, "_timed_write", full)
    (finding,), measured = check_disk(tmp_path, system)
    assert (finding.code, measured) == ("trial_failed", None)
    assert "No space left" in finding.what


def test_room_for_tonight() -> None:
    folder = Path("/var/lib/gyrorig")
    sixteen = RecordingLoad(12800.0, 100.0, 16)  # boards at 800 Hz, 64 bytes each: 2.97 GB an hour
    (finding,) = check_capacity(
        DiskMeasurement(folder, 20 * 10**9, 5e6), sixteen, ServiceSettings()
    )
    assert (finding.code, finding.level) == ("fills_up", Level.WARNING)
    assert "full in 6.4 h" in finding.what
    may_delete = ServiceSettings(delete_when_full=True)
    (finding,) = check_capacity(DiskMeasurement(folder, 20 * 10**9, 5e6), sixteen, may_delete)
    assert (finding.code, finding.level) == ("deletes", Level.NOTE)
    load = RecordingLoad(100.0, 100.0, 1)
    (finding,) = check_capacity(DiskMeasurement(folder, 200 * 10**9, 5e6), load, ServiceSettings())
    assert (finding.code, finding.level) == ("fits", Level.OK)
    findings = check_capacity(DiskMeasurement(folder, 10**8, 1e5), sixteen, ServiceSettings())
    assert codes(findings) == ["full", "disk_too_slow"]
    silent = RecordingLoad(0.0, 100.0, 1)
    assert codes(
        check_capacity(DiskMeasurement(folder, 10**9, 1e6), silent, ServiceSettings())
    ) == ["no_rate"]
    assert list(check_capacity(None, load, ServiceSettings())) == []


def test_what_stands_against_the_schedule() -> None:
    plain = ScheduleEntry(name="nightly", program="p.yaml", at_utc="02:00")
    homing = ScheduleEntry(name="weekly", program="p.yaml", every_h=168.0, home=True)

    def code(*entries: ScheduleEntry, **facts: bool) -> str:
        settings = {"needs_homing": False, "can_home_unattended": False, "motion_is_locked": False}
        return check_schedule_can_run(entries, **(settings | facts)).code

    assert code() == "no_schedule"
    assert code(plain, homing) == "schedule"
    assert code(plain, needs_homing=True) == "will_be_refused"
    assert code(homing, needs_homing=True) == "schedule"
    assert code(plain, needs_homing=True, can_home_unattended=True) == "schedule"
    assert code(plain, motion_is_locked=True) == "held"


@pytest.fixture
def port() -> Iterator[str]:
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(slave)
    os.close(master)


def test_a_free_port(system: SystemFiles, port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_check, "open_holders", lambda _: [])
    findings, state = check_port("unit", port, system)
    assert (findings, state.can_open) == ([], True)


def test_names_that_do_not_hold(
    system: SystemFiles, tmp_path: Path, port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(port_check, "_UNSTABLE", re.compile(r"/dev/pts/\d+"))
    put(system, "/dev/serial/by-id/x", "")
    better = system.path("/dev/serial/by-id/usb-FTDI_PTU00001-if00-port0")
    better.symlink_to(port)
    finding = check_port("unit", port, system)[0][0]
    assert finding.code == "unstable_name"
    named = "use /dev/serial/by-id/usb-FTDI_PTU00001-if00-port0 as the port"
    assert finding.remedy.startswith(named)


def test_what_is_in_the_way_of_a_port(system: SystemFiles, port: str) -> None:
    name = Path(port).name
    put(system, f"/sys/bus/usb-serial/devices/{name}/latency_timer", "16")
    put(system, "/proc/cmdline", f"console={name},115200 root=/dev/mmcblk0p2")
    findings, _ = check_port("unit", port, system)
    assert [f.code for f in findings if f.level] == ["latency_timer", "console"]
    assert "16 ms" in findings[0].what
    put(system, f"/sys/bus/usb-serial/devices/{name}/latency_timer", "1")
    put(system, "/proc/cmdline", "console=tty1")
    assert [f.code for f in check_port("unit", port, system)[0]] == ["latency_timer"]


def test_modem_manager(system: SystemFiles, monkeypatch: pytest.MonkeyPatch) -> None:
    put(system, "/proc/99/comm", "ModemManager")
    assert [f.code for f in port_check._check_modem_manager("unit", "/dev/ttyUSB0", system)] == [
        "modem_manager"
    ]
    assert list(port_check._check_modem_manager("unit", "/dev/ttyAMA0", system)) == []
    put(system, "/etc/udev/rules.d/70-gyrorig.rules", "")
    assert list(port_check._check_modem_manager("unit", "/dev/ttyUSB0", system)) == []


def test_the_mini_uart_of_a_pi(system: SystemFiles) -> None:
    put(system, "/proc/device-tree/model", "Raspberry Pi 4 Model B Rev 1.4\0")
    assert [f.code for f in port_check._check_kernel_use("unit", "/dev/ttyS0", system)] == [
        "mini_uart"
    ]
    assert list(port_check._check_kernel_use("unit", "/dev/ttyAMA0", system)) == []


def test_ports_that_are_none(system: SystemFiles, tmp_path: Path) -> None:
    (finding,), state = check_port("unit", "/dev/none", system)
    assert (finding.code, finding.level, state.can_open) == ("missing", Level.FAULT, False)
    put(system, "/x", "")
    (finding,), state = check_port("unit", str(system.path("/x")), system)
    assert (finding.code, state.can_open) == ("no_device", False)


@pytest.mark.parametrize("is_ours", [True, False])
def test_a_port_in_use(
    system: SystemFiles, port: str, monkeypatch: pytest.MonkeyPatch, is_ours: bool
) -> None:
    monkeypatch.setattr(port_check, "lock_holder", lambda _: PortHolder(4711, "minicom", is_ours))
    (finding,), state = check_port("unit", port, system)
    assert not state.can_open
    assert "process 4711" in finding.what
    assert finding.level is (Level.NOTE if is_ours else Level.FAULT)
