"""Record one session of an emulated rig with hidden effects, in this process.

What to use when: `RigDraw` describes the rig; `make_settings` converts it for the emulator;
`record` writes the recording; `simulate_course` returns the motion of the axes under a program, for
sizing before the recording.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from mcap.reader import make_reader
from tests.hidden.truth.programs import read_program_text

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import InjectionRequest, RigSettings
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.stepper_axis import AxisCommand
from gyrorig_daemon.emulator.rig_truth import RigTruth
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.session.emulation_options import estimate_session_s
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_daemon.session.session import record_session
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionEnvironment
from gyrorig_protocol.documents import dump_yaml, parse_yaml
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import parse_program
from gyrorig_protocol.recording.messages import imu_raw_topic

ROOT = Path(__file__).resolve().parents[3]
BOARD = "GY80-1"
ORIGIN_NS = 5_000_000_000  # time of power-up, on the rig's raw clock
_EPOCH_NS = 1_760_000_000_000_000_000  # begin of the first session; the next begins 100 s later
_GAP_NS = 100_000_000_000

ExtraEffects = Callable[[RigHooks], None]


@dataclass(frozen=True, slots=True)
class RigDraw:
    """Settings of the rig of one session; the emulator draws the rest from the seed."""

    seed: int
    program: str
    soak_k: float = 0.0
    ptu_baud: int = 115200
    command_time_ms: float = 5.0
    hide: tuple[InjectionRequest, ...] = ()
    noise_free: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """The motion of the axes under a program."""

    commands: Mapping[str, Sequence[AxisCommand]]  # `pan` and `tilt`
    end_ns: int  # the end, on the rig's clock
    span_s: tuple[float, float]  # of the recorded samples, since power-up

    @property
    def moves_s(self) -> list[tuple[str, float]]:
        """Axis and begin of each move, since power-up."""
        return [
            (axis, command[1])
            for axis, commands in self.commands.items()
            for command in commands
            if command[0] == "move"
        ]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedSession:
    """A recorded session."""

    rig: EmulatedRig
    course: Course


def make_settings(draw: RigDraw) -> RigSettings:
    """Return the settings of a session's rig."""
    request = _make_request(draw, Path())
    settings = emulated_rig_settings(request.config, draw.seed)
    return replace(
        settings,
        injections=draw.hide,
        noise_free=draw.noise_free,
        session_s=estimate_session_s(request.program),
        soak_k=draw.soak_k,
    )


def record(
    draw: RigDraw,
    path: Path,
    truth: RigTruth | None = None,
    extra_effects: ExtraEffects | None = None,
) -> RecordedSession:
    """Record a session at `path`.

    Args:
        draw: the rig.
        path: of the recording; its folder exists.
        truth: of the rig; None: drawn from its seed.
        extra_effects: adds effects to the rig that are not in the catalogue.
    """
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        request = _make_request(draw, Path(folder))
        settings = make_settings(draw)
        rig = EmulatedRig(settings, ORIGIN_NS, truth, extra_effects)
        hub = VirtualHub(rig)
        capture = CaptureClock(_EPOCH_NS + _GAP_NS * (draw.seed % 1_000_000), hub.now_ns())

        def read_host() -> HostClocks:
            now_ns = hub.now_ns()
            return HostClocks(now_ns, now_ns, capture.utc_ns(now_ns), 0.0, 0.0, 0)

        environment = SessionEnvironment(
            capture, read_host, threaded_writer=False, host="emulated", seed=settings.seed
        )
        made = record_session(hub, request, environment)
        span_s = _read_span_s(made, capture)
        made.replace(path)
    commands = {"pan": tuple(rig.stage.pan.commands), "tilt": tuple(rig.stage.tilt.commands)}
    return RecordedSession(rig, Course(commands, hub.now_ns(), span_s))


@lru_cache(maxsize=64)
def simulate_course(program: str, ptu_baud: int, command_time_ms: float) -> Course:
    """Return the motion of the axes under a program; rigs differ by a few ms only."""
    draw = RigDraw(0, program, 0.0, ptu_baud, command_time_ms, noise_free=True)
    with tempfile.TemporaryDirectory() as folder:
        return record(draw, Path(folder) / "course.mcap").course


def _make_request(draw: RigDraw, out: Path) -> SessionRequest:
    config_text = _make_rig_text(draw.ptu_baud, draw.command_time_ms)
    text = read_program_text(draw.program)
    return SessionRequest(
        config=parse_rig(config_text, "rig.yaml"),
        config_text=config_text,
        program=parse_program(text, f"{draw.program}.yaml"),
        program_text=text,
        out_dir=out,
        session=f"s{draw.seed}",
    )


@lru_cache(maxsize=64)
def _make_rig_text(ptu_baud: int, command_time_ms: float) -> bytes:
    """Return the shipped rig with another baud rate and controller."""
    document = parse_yaml((ROOT / "config" / "rig.yaml").read_bytes(), "rig.yaml")
    document["ptu"]["baud"] = ptu_baud
    document["emulator"]["command_time_ms"] = command_time_ms
    return dump_yaml(document).encode()


def _read_span_s(path: Path, capture: CaptureClock) -> tuple[float, float]:
    """Return the arrival times of the first and the last sample, since power-up."""
    with path.open("rb") as file:
        reader = make_reader(file)
        topics = [imu_raw_topic(BoardId(BOARD))]
        ends = [
            next(m.log_time for _, _, m in reader.iter_messages(topics, reverse=reverse))
            for reverse in (False, True)
        ]
    first, last = ((at_ns - capture.anchor_utc_ns) * 1e-9 for at_ns in ends)
    return first, last
