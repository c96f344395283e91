"""Generated pages of the reference: commands, documents, catalogue, sensors, Python.

What to use when: `PAGES` maps the name of each page to the function that makes its Markdown.
"""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
from docs.commands import EXIT_CODES, PROGRAMS, describe_commands
from docs.map_page import make_import_map_page

from gyrorig_daemon.emulator.injection import CAUSES
from gyrorig_protocol.profile import SensorProfile, parse_profile
from gyrorig_protocol.recording.encoding.message_schemas import SCHEMAS, SEPARATOR
from gyrorig_solver.model.catalogue import catalogue

ROOT = Path(__file__).resolve().parents[1]
# documents: title, module, top structure
DOCUMENTS = (
    (
        "Calibration, `gyrorig/calibration/1`",
        "gyrorig_solver.calibration.calibration_document",
        "CalibrationDocument",
    ),
    (
        "Findings, `gyrorig/findings/1`",
        "gyrorig_solver.findings.findings_document",
        "FindingsDocument",
    ),
    (
        "Motion program, `gyrorig/program/1`",
        "gyrorig_protocol.program.program_document",
        "MotionProgram",
    ),
    (
        "Sensor profile, `gyrorig/sensor/1`",
        "gyrorig_protocol.profile.sensor_profile",
        "SensorProfile",
    ),
    ("Rig, `gyrorig/rig/1`", "gyrorig_daemon.config.rig_document", "RigConfig"),
    ("Twin, `gyrorig/twin/1`, in a rig", "gyrorig_protocol.twin.twin_document", "Twin"),
)
# Public interface for Python programs: module and names.
PYTHON = (
    ("gyrorig_solver.apply.board_calibration", ("Calibration",)),
    ("gyrorig_protocol.recording.reader", ("read_recording", "read_recording_metadata")),
    ("gyrorig_protocol.recording.recording", ("Recording", "times_ns")),
    ("gyrorig_protocol.recording.writer", ("RecordingWriter",)),
    ("gyrorig_solver.data.samples", ("load_samples", "GyroSamples")),
    ("gyrorig_solver.pipeline.fit_board", ("solve_recordings",)),
    ("gyrorig_solver.estimate.gyro_fit", ("GyroFit", "ObservabilityReport", "NoiseLevels")),
    (
        "gyrorig_solver.calibration.calibration_document",
        ("parse_calibration", "calibration_as_yaml"),
    ),
    ("gyrorig_solver.calibration.calibration_store", ("CalibrationStore",)),
    ("gyrorig_solver.importers", ("import_files", "import_measurements", "load_import_map")),
    ("gyrorig_protocol.errors", ("GyrorigError", "UsageError", "InputError", "DeviceError")),
)


def commands() -> str:
    """Return the page of all commands of both programs."""
    out = ["# Commands", "", "Made of the programs' own help.", "", "## Exit codes", ""]
    out += ["| code | means |", "|---|---|", *(f"| {code} | {text} |" for code, text in EXIT_CODES)]
    for program in PROGRAMS:
        out += ["", f"## {program}", ""]
        for command in describe_commands(program):
            out += [f"### `{command.name}`", "", "```text", command.usage, "```", ""]
            for paragraph in command.paragraphs:
                out += [_escape(paragraph), ""]
            if command.options:
                out += ["| option | |", "|---|---|"]
                out += [
                    f"| `{_escape_cell(o)}` | {_escape_cell(_escape(t))} |"
                    for o, t in command.options
                ]
                out.append("")
            if command.examples:
                out += ["```sh", *command.examples, "```", ""]
    return "\n".join(out)


def causes() -> str:
    """Return the page of all causes, with those that an emulated rig can hide."""
    out = [
        "# Catalogue of causes",
        "",
        "What `gyrorig explain` can name, `gyrorig solve --extend` can fit, and an emulated rig "
        "can hide with `--hide`. An id says the physical cause; none is ever renamed.",
        "",
        "| id | part | scope | shows as | hide |",
        "|---|---|---|---|---|",
    ]
    known = catalogue()
    for name, term in known.items():
        hidden = CAUSES.get(name)
        places = ", ".join(hidden.components) if hidden is not None and hidden.components else ""
        hide = "no" if hidden is None else f"`{name}{'@' + hidden.components[0] if places else ''}`"
        out.append(f"| [{name}](#{name}) | {term.part} | {term.scope} | {term.kind} | {hide} |")
    for name, term in known.items():
        out += ["", f"## {name}", "", f"Part: {term.part}. Scope: {term.scope}.", ""]
        out += [f"Equation: `{term.equation}`.", ""]
        out += [f"Motion or data that show this cause: {_escape(term.excitation)}.", ""]
        out.append(
            f"Effect on a calibration that ignores this cause: {_escape(term.effect_if_ignored)}."
        )
        if term.confused_with:
            out += ["", f"Looks like, under some programs: {', '.join(term.confused_with)}."]
        if term.parameters:
            out += [
                "",
                "| parameter | parts | unit | typical | possible |",
                "|---|---|---|---|---|",
            ]
            out += [
                f"| {p.name} | {', '.join(p.components) or '-'} | {p.unit} "
                f"| {p.typical_size:.3g} | "
                f"{p.lower:.3g} to {p.upper:.3g} |"
                for p in term.parameters
            ]
        hidden = CAUSES.get(name)
        if hidden is not None:
            out += ["", f"Hidden by the emulator: {_escape(hidden.size_meaning)}, "
                    f"in {hidden.unit if hidden.unit != '1' else 'parts'}."]  # fmt: skip
    return "\n".join([*out, ""])


def sensors() -> str:
    """Return the page of the profiles in config/boards."""
    profiles = [
        parse_profile(path.read_bytes(), path.name)
        for path in sorted(
            (ROOT / "config" / "boards").glob("*.yaml"), key=lambda p: p.stem.lower()
        )
    ]
    out = [
        "# Sensors",
        "",
        "The profiles in `config/boards` contain the limits of the data sheets. A calibration with "
        "a value outside these limits has a note. A plan uses the noise of a profile. "
        "[Add a profile](../how-to/sensor-profile.md).",
        "",
        "| part | ranges, deg/s | deg/s/√Hz | zero rate, deg/s | per K | scale | cross-axis |",
        "|---|---|---|---|---|---|---|",
    ]
    for profile in profiles:
        ranges = ", ".join(f"{r.full_scale_dps:g}" for r in profile.ranges)
        out.append(
            f"| [{profile.sensor}](#{_make_anchor(profile.sensor)}) | {ranges} | "
            f"{_format_number(profile.noise_density_dps_rthz)} | "
            f"±{_format_number(profile.zero_rate_dps)} | "
            f"{_format_number(profile.zero_rate_per_kelvin_dps)} | "
            f"{_format_percent(profile.scale_tolerance)} | {_format_percent(profile.cross_axis)} |"
        )
    for profile in profiles:
        out += ["", f"## {profile.sensor}", "", f"{_escape(profile.source)}.", ""]
        out += ["| range, deg/s | mdps/count |", "|---|---|"]
        out += [f"| {r.full_scale_dps:g} | {r.sensitivity_mdps:.6g} |" for r in profile.ranges]
        out += [""] + [f"- {text}" for text in _list_other_figures(profile)]
    return "\n".join([*out, ""])


def _list_other_figures(profile: SensorProfile) -> Iterator[str]:
    for entry in profile.low_pass:
        widths = ", ".join(f"{hz:g}" for hz in entry.bandwidth_hz)
        yield f"low-pass at {entry.odr_hz:g} Hz: {widths} Hz"
    for value, text in (
        (profile.bias_instability_dps_h, "bias instability {:g} deg/h"),
        (profile.scale_per_kelvin, "scale {:g} per K"),
        (profile.scale_over_temperature, "scale {:g} over the part's temperatures"),
        (profile.nonlinearity, "non-linearity {:g} of full scale"),
        (profile.g_sensitivity_dps_g, "g-sensitivity {:g} deg/s per g"),
        (profile.odr_tolerance, "output rate within {:g} of its nominal one"),
    ):
        if value is not None:
            yield text.format(value)


def formats() -> str:
    """Return the page of the fields of all documents and the definitions of all messages."""
    out = [
        "# Documents and messages",
        "",
        "The shapes as the code checks them: a key that is not here is refused.",
    ]
    for title, module, top in DOCUMENTS:
        kind = getattr(import_module(module), top, None)
        if kind is None:
            raise LookupError(f"{module} has no {top}")
        out += ["", f"## {title}", "", _escape(inspect.getdoc(kind) or "")]
        described_structs: set[Any] = set()
        open_structs = [kind]
        while open_structs:
            struct = open_structs.pop(0)
            if struct in described_structs:
                continue
            described_structs.add(struct)
            if struct is not kind:
                anchor = f"{top.lower()}-{struct.__name__.lower()}"
                summary = (inspect.getdoc(struct) or "").split("\n\n")[0]
                out += ["", f"### {struct.__name__} {{ #{anchor} }}", "", _escape(summary)]
            out += ["", "| key | type | default |", "|---|---|---|"]
            for field in msgspec.structs.fields(struct):
                out.append(
                    f"| {field.encode_name} | {_escape_cell(_format_type(field.type))} "
                    f"| {_format_default(field)} |"
                )
                open_structs += _find_structs(field.type)
    out += ["", "## Messages of a recording", ""]
    out.append(
        "MCAP, profile `ros2`, encoding `cdr`; the types are those of ROS 2 and of `gyrorig_msgs`."
    )
    for name, text in SCHEMAS.items():
        out += ["", f"### {name}", "", "```text", text.split(SEPARATOR)[0].rstrip(), "```"]
    return "\n".join([*out, ""])


def python() -> str:
    """Return the page of the public Python interface."""
    out = [
        "# Python",
        "",
        "What a program may rely on; everything else may move. Arrays are NumPy's, float64 if "
        "not said.",
        "",
    ]
    for module_name, names in PYTHON:
        module = import_module(module_name)
        out += [f"## {module_name}", "", _convert_docstring(inspect.getdoc(module) or ""), ""]
        for name in names:
            member = getattr(module, name)
            out += [f"### {name} {{ #{module_name.replace('.', '-')}-{name.lower()} }}", ""]
            out += [
                "```python",
                _format_signature(name, member),
                "```",
                "",
                _convert_docstring(inspect.getdoc(member) or ""),
                "",
            ]
            if inspect.isclass(member):
                for inner_name, value in _list_members(member):
                    out += ["```python", _format_signature(inner_name, value), "```", "",
                            _convert_docstring(inspect.getdoc(value) or ""), ""]  # fmt: skip
    return "\n".join(out)


def _list_members(kind: type) -> Iterator[tuple[str, Any]]:
    for name, value in vars(kind).items():
        if name.startswith("_"):
            continue
        if isinstance(value, classmethod | staticmethod):
            yield name, value.__func__
        elif isinstance(value, property) or inspect.isfunction(value):
            yield name, value


def _format_signature(name: str, member: Any) -> str:
    if isinstance(member, property):
        annotation = inspect.signature(member.fget).return_annotation if member.fget else "Any"
        return f"{name}: {_format_annotation(annotation)}"
    try:
        text = str(inspect.signature(member))
    except (TypeError, ValueError):
        text = "(...)"
    word = "class" if inspect.isclass(member) else "def"
    return re.sub(
        r"(pathlib|numpy|typing|collections\.abc|gyrorig_\w+(?:\.\w+)*)\.",
        "",
        f"{word} {name}{text}",
    )


def _format_annotation(annotation: Any) -> str:
    return (
        annotation
        if isinstance(annotation, str)
        else getattr(annotation, "__name__", str(annotation))
    )


def _convert_docstring(text: str) -> str:
    """Convert a docstring in Google style to Markdown."""
    out: list[str] = []
    section = in_code = False
    for line in text.splitlines():
        # An indented line outside a section is an example.
        if not section and (line.startswith("    ") or (in_code and not line.strip())):
            if not in_code:
                out.append("```python")
            in_code = True
            out.append(line[4:])
            continue
        if in_code:
            while not out[-1]:
                out.pop()
            out += ["```", ""]
            in_code = False
        heading = re.fullmatch(r"(Args|Returns|Raises|Source|Yields):", line)
        if heading:
            section = True
            out += ["", f"**{heading[1]}**", ""]
        elif section and re.match(r"    \S", line):
            item = re.match(r"    (\*{0,2}\w[\w, *]*): (.*)", line)
            out.append(
                f"- `{item[1]}`: {_escape(item[2])}" if item else f"- {_escape(line.strip())}"
            )
        elif section and line.startswith("        "):
            out[-1] += f" {_escape(line.strip())}"
        else:
            section = section and not line.strip()
            out.append(_escape(line.strip()))
    return "\n".join([*out, "```"] if in_code else out)


def _escape(text: str) -> str:
    """Escape the characters that Markdown or HTML would interpret, outside of code."""
    parts = text.split("`")
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(r"([<>*_\[\]|])", r"\\\1", parts[k])
    return "`".join(parts)


def _escape_cell(text: str) -> str:
    return re.sub(r"(?<!\\)\|", r"\\|", text)


def _format_type(kind: Any) -> str:
    text = kind.__name__ if inspect.isclass(kind) else str(kind)
    text = re.sub(r", Meta\((.*?)\)\]", "]", re.sub(r"msgspec\.", "", text))
    for _ in range(3):  # nested annotations
        text = re.sub(r"(?:typing\.)?Annotated\[(\w+(?:\[[^\[\]]*\])?)\]", r"\1", text)
    return _escape(re.sub(r"(?:typing|gyrorig_\w+(?:\.\w+)*)\.|<class '|'>", "", text))


def _format_default(field: Any) -> str:
    if field.required:
        return "required"
    if field.default is msgspec.NODEFAULT:
        return "made"
    value = field.default
    if isinstance(value, msgspec.Struct):
        return "made"
    return "" if value is None else f"`{_escape_cell(repr(value))}`"


def _find_structs(kind: Any) -> list[Any]:
    if inspect.isclass(kind) and issubclass(kind, msgspec.Struct):
        return [kind]
    return [struct for inner in getattr(kind, "__args__", ()) for struct in _find_structs(inner)]


def _make_anchor(text: str) -> str:
    return re.sub(r"[^a-z0-9-]", "", text.lower())


def _format_number(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def _format_percent(value: float | None) -> str:
    return "" if value is None else f"±{100 * value:g} %"


def decisions() -> str:
    """Return the page with the titles of all decisions."""
    out = [
        "# Decisions",
        "",
        "Each choice that somebody will ask about, with the option refused.",
        "",
    ]
    for record in sorted((ROOT / "docs" / "decisions").glob("[0-9]*.md")):
        title = record.read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        out.append(f"- [{_escape(title)}]({record.name})")
    return "\n".join([*out, ""])


PAGES: Mapping[str, Callable[[], str]] = MappingProxyType(
    {
        "reference/commands.md": commands,
        "reference/catalogue.md": causes,
        "reference/sensors.md": sensors,
        "reference/formats.md": formats,
        "reference/import-map.md": make_import_map_page,
        "reference/python.md": python,
        "decisions/index.md": decisions,
    }
)
