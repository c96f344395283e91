"""A rig of a twin: devices, draws, and what it does not have."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy.stats
from tests.support.stated_causes import BEGIN_S, END_S, stated_twin

from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, PtuSettings, RigSettings
from gyrorig_daemon.emulator.injection import parse_injection
from gyrorig_daemon.emulator.physics.host_latency import LatencyTruth
from gyrorig_daemon.emulator.rig_truth import sample_rig_truth
from gyrorig_daemon.emulator.twin import OTHER_RECORDING, draw_twin, make_twin_rig
from gyrorig_daemon.emulator.twin.twin_devices import link_delay_s, unit_lag_s
from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.twin import Twin, check_twin, twin_to_plain
from gyrorig_protocol.twin.twin_checks import CAUSE_UNITS
from gyrorig_solver.model.catalogue import catalogue

ROOT = Path(__file__).resolve().parents[3]
SETTINGS = RigSettings(seed=9, session_s=(BEGIN_S, END_S))


def plain_twin(*hide: str) -> dict[str, Any]:
    """Return a twin as plain values."""
    injections = tuple(parse_injection(text) for text in hide)
    settings = RigSettings(seed=5, injections=injections, session_s=(BEGIN_S, END_S))
    return twin_to_plain(stated_twin(EmulatedRig(settings, 0)))


def quantity(value: float, std: float | None = None, unit: str = "s") -> dict[str, Any]:
    """Return a plain number of a twin."""
    return {"value": value, "std": std, "unit": unit}


def twin_of(plain: dict[str, Any]) -> Twin:
    """Return a twin from plain values."""
    return msgspec.convert(plain, Twin)


def test_devices_are_those_of_the_twin() -> None:
    plain = plain_twin()
    plain["unit"] = {
        "answer_time": quantity(8e-3),
        "start_delay": quantity(2e-3),
        "counter": {"skew": quantity(3e-5), "tick_hz": 1e6},
        "facts": {"resolution_arcsec": 92.571, "pan_max_steps": 6180, "serial": "X1"},
    }
    plain["link"] = {"jitter": quantity(7e-4), "stall_interval": quantity(0.0)}
    board = plain["boards"]["GY80-1"]
    board["full_scale"] = quantity(math.radians(1000.0), None, "rad/s")
    board["clock"] = {"skew": quantity(-2e-5, None, "1"), "tick_hz": 1e6}
    made = make_twin_rig(twin_of(plain), SETTINGS)
    unit = made.settings.ptu
    assert unit is not None
    assert (unit.command_time_ms, unit.sample_fraction) == (8.0, 0.5)
    assert unit.start_delay_ms == pytest.approx(-2.0)  # 2 ms instead of half of the answer time
    assert unit.resolution_arcsec == pytest.approx(92.571)
    assert (unit.pan_max_steps, unit.serial) == (6180, "X1")
    assert made.truth.controller_clock.skew == 3e-5
    assert (made.truth.latency.jitter_s, made.truth.latency.stall_interval_s) == (7e-4, 0.0)
    assert made.truth.latency.floor_s == 60e-6  # as always
    imu = made.truth.boards["GY80-1"].imu
    assert made.settings.boards[0].full_scale_dps == 1000.0
    assert imu.gyro_limit_rad_s == pytest.approx(math.radians(1000.0))
    assert imu.gyro_scale_rad_s == pytest.approx(math.radians(1000.0) / 32768.0, rel=1e-4)
    assert made.truth.boards["GY80-1"].clock.skew == -2e-5
    assert np.linalg.det(imu.mounting) == pytest.approx(1.0)
    factors = made.truth.boards["GY80-1"]
    product = factors.scale @ factors.nonorthogonality @ imu.mounting
    assert product == pytest.approx(np.array(board["gain"]["value"]), abs=1e-12)


def test_early_samples_have_early_timestamps() -> None:
    plain = plain_twin()
    plain["boards"]["GY80-1"]["time_offset"] = quantity(-4e-3)
    made = make_twin_rig(twin_of(plain), SETTINGS)
    board = made.truth.boards["GY80-1"]
    lag_s = np.sqrt(2.0) / (2.0 * np.pi * board.imu.bandwidth_hz)
    assert board.imu.tau_s == 0.0
    link_s = link_delay_s(made.settings.boards[0], board, made.truth.latency)
    unit_s = unit_lag_s(made.truth.latency)
    assert board.stamp_early_s == pytest.approx(4e-3 + lag_s + link_s + unit_s)


def test_the_link_is_not_counted_twice_in_the_time_offset() -> None:
    latency = LatencyTruth(floor_s=60e-6, write_floor_s=50e-6)
    exchanges = BoardSettings(baud=115200)
    truth = sample_rig_truth(RigSettings(boards=(exchanges,))).boards[exchanges.name]
    assert link_delay_s(exchanges, truth, latency) == pytest.approx(699.4e-6, abs=1e-6)
    one_way = replace(exchanges, format="text", text_time=True)
    assert 2e-3 < link_delay_s(one_way, truth, latency) < 5e-3
    assert link_delay_s(replace(exchanges, bus="can0"), truth, latency) == 0.0


def test_causes_that_cannot_be_emulated_are_named() -> None:
    plain = plain_twin()
    share = {"share": quantity(0.1, None, "1")}
    plain["causes"] = [
        {"cause": "stuck_axis", "where": "x", "board": "GY80-1", "parameters": share},
        {"cause": "clock_step", "where": "all", "board": "GY80-1",
         "parameters": {"count": quantity(2.0, None, "1")}},
    ]  # fmt: skip
    made = make_twin_rig(twin_of(plain), SETTINGS)
    assert not made.truth.injected
    assert [note.split("cause ")[1].split(",")[0] for note in made.notes] == [
        "stuck_axis",
        "clock_step",
    ]


def test_a_missing_value_is_an_error() -> None:
    plain = plain_twin("clock_skew")
    plain["causes"][0]["parameters"] = {"share": quantity(0.1, None, "1")}
    with pytest.raises(UsageError, match="clock_skew of the twin cannot be used"):
        make_twin_rig(twin_of(plain), SETTINGS)


def test_events_of_another_recording_do_not_happen() -> None:
    plain = plain_twin("bias_step", "board_slip")
    first = plain["recordings"][0]
    plain["recordings"] = [first, {**first, "name": "b.mcap", "begin_s": 7.3, "end_s": 30.0}]
    plain["causes"][0]["recording"] = "b.mcap"
    twin = twin_of(plain)
    assert [c.cause for c in make_twin_rig(twin, SETTINGS).truth.injected] == ["board_slip"]
    both = make_twin_rig(twin, SETTINGS, "b.mcap").truth.injected
    stated = plain["causes"][0]["parameters"]["time"]["value"]
    assert both[0].cause == "bias_step"
    # Findings give times of the motion, and a sample shows it a few ms later.
    assert both[0].number("at") == pytest.approx(stated - 7.3 + BEGIN_S, abs=0.01)


def test_in_another_recording_no_single_event_happens() -> None:
    plain = plain_twin("bias_step", "scale_cubic")
    plain["causes"][0]["recording"] = plain["recordings"][0]["name"]
    made = make_twin_rig(twin_of(plain), SETTINGS, OTHER_RECORDING)
    assert [cause.cause for cause in made.truth.injected] == ["scale_cubic"]
    assert made.notes == (
        f"bias_step happened once, in {plain['recordings'][0]['name']}, and is not repeated",
    )


@pytest.mark.parametrize("cause", ["supply_hum", "clock_sawtooth"])
def test_in_another_recording_what_repeats_has_another_phase(cause: str) -> None:
    twin = twin_of(plain_twin(cause))

    def phase(recording: str | None, session_seed: int) -> float:
        settings = replace(SETTINGS, session_seed=session_seed)
        (injected,) = make_twin_rig(twin, settings, recording).truth.injected
        if cause == "supply_hum":
            return injected.number("phase") / (2.0 * math.pi)
        return injected.number("at") / injected.number("period")

    assert phase(None, 1) == phase(None, 2)
    shares = [(phase(None, 1) - phase(OTHER_RECORDING, seed)) % 1.0 for seed in range(200)]
    assert scipy.stats.kstest(shares, "uniform").pvalue > 1e-3
    assert phase(OTHER_RECORDING, 7) == phase(OTHER_RECORDING, 7)


@pytest.mark.parametrize("unit", ["deg", "mrad", "arcsec", ""])
def test_a_cause_in_another_unit_is_refused(unit: str) -> None:
    """The emulator would take 0.5 deg as 0.5 rad."""
    plain = plain_twin()
    sizes = {"gap.pan": quantity(0.5, None, unit)}
    plain["causes"] = [{"cause": "backlash", "where": "pan", "parameters": sizes}]
    with pytest.raises(UsageError, match="is not the SI unit of a cause"):
        check_twin(msgspec.convert(plain, Twin), "twin.yaml")


@pytest.mark.parametrize("cause", catalogue())
def test_the_units_of_the_catalogue_are_accepted(cause: str) -> None:
    assert {parameter.unit for parameter in catalogue()[cause].parameters} <= CAUSE_UNITS


def test_hidden_causes_are_added_to_those_of_the_twin() -> None:
    settings = RigSettings(
        seed=9, session_s=(BEGIN_S, END_S), injections=(parse_injection("s_curve"),)
    )
    made = make_twin_rig(twin_of(plain_twin("warm_up")), settings)
    assert [cause.cause for cause in made.truth.injected] == ["warm_up", "s_curve"]


def test_draws_follow_the_posterior_and_are_reproducible() -> None:
    plain = plain_twin("warm_up")
    board = plain["boards"]["GY80-1"]
    board["odr"]["std"] = 0.01
    names = ["boards.GY80-1.gain.0.2", "boards.GY80-1.bias.1", "causes.0.begin.x"]
    std = np.array([2e-4, 1e-5, 3e-5])
    correlation = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, -0.4], [0.0, -0.4, 1.0]])
    covariance = correlation * np.outer(std, std)
    plain["posterior"] = {"names": names, "covariance": covariance.tolist()}
    twin = twin_of(plain)
    assert draw_twin(twin, 0) is twin
    assert draw_twin(twin, 7) == draw_twin(twin, 7)

    def values(drawn: Twin) -> list[float]:
        board_drawn = drawn.boards["GY80-1"]
        begin = drawn.causes[0].parameters["begin.x"].value
        return [
            board_drawn.gain.value[0][2],
            board_drawn.bias.value[1],
            begin,
            board_drawn.odr.value if board_drawn.odr else 0.0,
        ]

    draws = np.array([values(draw_twin(twin, number)) for number in range(1, 2001)])
    deviations = (draws - values(twin)) / [*std, 0.01]
    assert np.abs(deviations.mean(axis=0)).max() < 0.1
    assert np.abs(np.corrcoef(deviations[:, :3].T) - correlation).max() < 0.06
    assert deviations.std(axis=0) == pytest.approx(np.ones(4), abs=0.06)
    unchanged = draw_twin(twin, 3).boards["GY80-1"].gain.value[0][0]
    assert unchanged == twin.boards["GY80-1"].gain.value[0][0]


@pytest.mark.parametrize(
    ("hidden", "place", "remedy"),
    [("backlash@pan", "roll", "pan, tilt or all"), ("bias_step", "pan", "x, y, z or all")],
)
def test_a_place_that_the_device_does_not_have_is_refused(
    hidden: str, place: str, remedy: str
) -> None:
    plain = plain_twin(hidden)
    plain["causes"][0]["where"] = place
    with pytest.raises(UsageError, match=f"has the place '{place}'") as caught:
        make_twin_rig(twin_of(plain), SETTINGS)
    assert remedy in caught.value.remedy


def test_the_interval_of_stalls_is_drawn_from_their_count() -> None:
    """No stall in 60 s leaves a rate of 0.5 per 60 s on average; 9 stalls in 180 s give 9.5."""
    for value, std, mean_rate_hz in ((0.0, 60.0, 0.5 / 60.0), (20.0, 20.0 / 3.0, 9.5 / 180.0)):
        plain = plain_twin("warm_up")
        plain["link"] = {"stall_interval": {"value": value, "std": std, "unit": "s"}}
        twin = twin_of(plain)
        intervals = [draw_twin(twin, number).link.stall_interval for number in range(1, 2001)]
        rates_hz = [1.0 / interval.value for interval in intervals if interval is not None]
        assert np.mean(rates_hz) == pytest.approx(mean_rate_hz, rel=0.1)


def test_a_rig_file_with_a_twin_is_read() -> None:
    import yaml  # noqa: PLC0415

    rig = yaml.safe_load((ROOT / "config" / "rig.yaml").read_text())
    rig["twin"] = plain_twin("worm_error")
    config = parse_rig(dump_yaml(rig), "twin.yaml")
    assert config.twin is not None
    assert config.twin.causes[0].cause == "worm_error"
    rig["boards"][0]["id"] = "GY80-2"
    with pytest.raises(UsageError, match="no board GY80-2"):
        parse_rig(dump_yaml(rig), "twin.yaml")
    rig["boards"][0]["id"] = "GY80-1"
    rig["twin"]["causes"][0]["board"] = "GY80-7"
    with pytest.raises(UsageError, match=r"twin\.yaml: twin: causes, entry 1"):
        parse_rig(dump_yaml(rig), "twin.yaml")


@pytest.mark.parametrize("board_count", [2])
def test_a_cause_on_one_of_several_boards_needs_its_board(board_count: int) -> None:
    plain = plain_twin("warm_up")
    plain["boards"]["B2"] = plain["boards"]["GY80-1"]
    boards = tuple(BoardSettings(name=name) for name in ("GY80-1", "B2")[:board_count])
    settings = RigSettings(seed=9, boards=boards, ptu=PtuSettings(), session_s=(BEGIN_S, END_S))
    (cause,) = make_twin_rig(twin_of(plain), settings).truth.injected
    assert cause.board == "GY80-1"
    plain["causes"][0]["board"] = None
    with pytest.raises(UsageError, match="warm_up of the twin has no board"):
        make_twin_rig(twin_of(plain), settings)
