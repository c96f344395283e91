"""The table of cases of the golden set: one command line each.

What to use when: add a line to `SESSIONS` for an emulated recording, and a line to
`commands` for a program that reads it; then run `make goldens-update`.

A command is what a user types. `{NAME}` is the output folder of the case or material NAME,
and makes this case wait for it; `{out}` is the case's own folder. `config/`, `data/`
and `contracts/` are the folders of the tree under test, of the measured data and of the
published contracts. `s3://` is a bucket on this machine. A star is expanded to sorted names.
"""

import re
import shlex
from dataclasses import dataclass

from tests.goldens.commands import COMMANDS
from tests.goldens.materials import MATERIALS

RECORD = "gyrorigd record --simulated-time --json --session golden --out {out} "
BUCKET_READERS = ("bucket-ls", "bucket-diff", "bucket-verify", "bucket-fleet")
OPTIONAL_FOLDERS = ("data", "contracts")
_PLACEHOLDER = re.compile(r"\{([a-z0-9-]+)\}")
_DAY_NS = 86_400_000_000_000
_FIRST_DAY_NS = 1_767_225_600_000_000_000  # 2026-01-01T00:00:00Z


@dataclass(frozen=True, slots=True)
class Case:
    """One command and where its results are.

    Attributes:
        name: of the case, its folder and its stored result.
        command: as typed, with placeholders.
        clock_ns: time of day that the process sees, UTC; 0 for the real one.
        folder: folder whose files are kept, when it is not the case's own.
    """

    name: str
    command: str
    clock_ns: int = 0
    folder: str = ""

    @property
    def needs(self) -> frozenset[str]:
        """Names of the cases and materials that must exist before this case runs."""
        names = frozenset(_PLACEHOLDER.findall(self.command)) - {"out"}
        return names | {"batch-bucket"} if self.name in BUCKET_READERS else names

    @property
    def output_folder(self) -> str:
        """Folder whose files are kept, inside the working folder."""
        return self.folder or self.name

    def words(self) -> list[str]:
        """Return the command's words, with folders in place of placeholders."""
        text = self.command.replace("{out}", self.name)
        return shlex.split(_PLACEHOLDER.sub(lambda match: match[1], text))


# name: rig, program, seed and what is hidden. A rig without a slash is one of config/.
SESSIONS = {
    "rec-plain": "rig survey-40 --seed 3",
    "rec-quick": "rig quick --seed 3",
    "rec-rest": "rig static --seed 3",
    "rec-noise-free": "rig quick --seed 4 --noise-free",
    "rec-random": "rig quick --seed 21 --hide random",
    "rec-backlash": "rig survey-40 --seed 31 --hide backlash@tilt:0.0015",
    "rec-clock-offset": "rig quick --seed 32 --hide clock_offset:0.01",
    "rec-clock-step": "rig survey-40 --seed 33 --hide clock_step:0.01",
    "rec-lost-samples": "rig quick --seed 34 --hide lost_samples:0.01",
    "rec-repeated": "rig quick --seed 35 --hide repeated_samples:0.02",
    "rec-jitter": "rig survey-40 --seed 36 --hide sample_jitter:0.002",
    "rec-corrupt": "rig quick --seed 37 --hide corrupt_samples:0.005",
    "rec-axis-swap": "rig quick --seed 38 --hide axis_swap@xy",
    "rec-sign-flip": "rig quick --seed 39 --hide sign_flip@z",
    "rec-full-scale": "rig quick --seed 40 --hide wrong_full_scale:2",
    "rec-low-pass": "rig survey-40 --seed 41 --hide low_pass_lag:0.4",
    "rec-cubic": "rig survey-40 --seed 42 --hide scale_cubic@z:0.008",
    "rec-asymmetry": "rig survey-40 --seed 43 --hide scale_asymmetry@x:0.008",
    "rec-saturation": "rig quick --seed 44 --hide saturation@z:1.2",
    "rec-thermal": "rig survey-40 --seed 45 --soak 15 --hide thermal_bias:0.001",
    "rec-bias-step": "rig survey-40 --seed 46 --hide bias_step@y:0.003",
    "rec-hum": "rig survey-40 --seed 47 --hide supply_hum@x:0.004",
    "rec-motor": "rig survey-40 --seed 48 --hide motor_coupling@y:0.002",
    "rec-eccentricity": "rig survey-40 --seed 49 --hide eccentricity@pan:0.0017",
    "rec-square": "rig survey-40 --seed 50 --hide axis_nonorthogonality:0.009",
    "rec-s-curve": "rig survey-40 --seed 51 --hide s_curve@pan:0.08",
    "rec-lost-steps": "rig survey-40 --seed 52 --hide lost_steps@pan:16",
    "rec-slip": "rig survey-40 --seed 53 --hide board_slip:0.015",
    "rec-two": "rig survey-40 --seed 54 --hide backlash@tilt:0.002 --hide bias_step@x:0.003",
    "rec-three": "rig survey-40 --seed 55 --soak 12 --hide thermal_bias:0.001 "
    "--hide scale_asymmetry@z:0.008 --hide lost_samples:0.01",
    "rec-four": "{rigs}/four.yaml quick --seed 61",
    "rec-four-pan": "{rigs}/four.yaml survey-40 --seed 62 --hide backlash@pan:0.002",
    "rec-sixteen": "rig-sixteen {programs}/short.yaml --seed 63",
    "rec-can": "{rigs}/can.yaml {programs}/short.yaml --seed 64",
    "rec-d46": "{rigs}/d46.yaml quick --seed 65",
    "rec-home": "{rigs}/not-homed.yaml {programs}/short.yaml --seed 66 --home",
}


# Sessions whose recording is also searched for causes; the rest is checked and solved.
EXPLAINED = (
    "plain rest backlash clock-step lost-samples repeated jitter corrupt axis-swap sign-flip "
    "full-scale low-pass cubic asymmetry saturation thermal bias-step hum motor eccentricity "
    "square s-curve lost-steps slip two three can"
)
SOLVED = (
    "plain quick rest noise-free clock-offset lost-samples corrupt axis-swap saturation four "
    "sixteen can d46 home"
)
CHECKED = "plain rest lost-samples repeated corrupt saturation clock-step sixteen can"
EXTENDED = {
    "backlash": "auto",
    "four": "auto",
    "plain": "g_sensitivity,thermal_bias",
    "thermal": "thermal_bias",
    "asymmetry": "scale_asymmetry",
    "cubic": "scale_cubic,scale_quadratic",
    "eccentricity": "eccentricity",
    "low-pass": "low_pass_lag",
    "two": "auto",
    "four-pan": "auto",
}


def _session(index: int, name: str, text: str) -> Case:
    """Return the case that records a session; each session has its own day."""
    rig, program, *more = text.split()
    config = rig if "/" in rig else f"config/{rig}.yaml"
    motion = program if "/" in program else f"config/programs/{program}.yaml"
    command = f"{RECORD} --truth {{out}}/truth.yaml --config {config} --program {motion}"
    return Case(name, " ".join([command, *more]), _FIRST_DAY_NS + index * _DAY_NS)


def all_cases() -> dict[str, Case]:
    """Return every case by its name, in the order of the table."""
    cases = [_session(index, *item) for index, item in enumerate(SESSIONS.items())]
    for name in CHECKED.split():
        cases.append(Case(f"check-{name}", f"gyrorig check {{rec-{name}}}/*.mcap --json"))
    for name in SOLVED.split():
        command = f"gyrorig solve {{rec-{name}}}/*.mcap --extend none --out {{out}} --json"
        cases.append(Case(f"solve-{name}", command))
    for name in EXPLAINED.split():
        command = f"gyrorig explain {{rec-{name}}}/*.mcap --out {{out}} --json"
        cases.append(Case(f"explain-{name}", command))
    for name, causes in EXTENDED.items():
        command = f"gyrorig solve {{rec-{name}}}/*.mcap --extend {causes} --out {{out}} --json"
        cases.append(Case(f"extend-{name}", command))
    cases.append(Case("recover", "gyrorigd recover {unclean} --json", folder="unclean"))
    cases += [Case(name, command) for name, command in COMMANDS.items()]
    by_name = {case.name: case for case in cases}
    if len(by_name) != len(cases) or set(by_name) & set(MATERIALS):
        raise ValueError("two cases or materials have one name")
    return by_name
