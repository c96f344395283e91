"""Reading and checking of the section `twin` of a rig file, and its plain form."""

from itertools import pairwise
from typing import Any

import msgspec

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_protocol.twin.twin_document import (
    Matrix,
    Scalar,
    Twin,
    TwinBoard,
    TwinClock,
    TwinLink,
    TwinTemperature,
    Vector,
)

SYMMETRY_TOLERANCE = 1e-6  # of the covariance, relative to the standard deviations
RIG_SCHEMA = "gyrorig/rig/1"
UNITS = {
    "gain": "1",
    "bias": "rad/s",
    "noise_density": "rad/s/sqrt(Hz)",
    "bias_instability": "rad/s",
    "rate_random_walk": "rad/s/sqrt(s)",
    "noise_floor": "rad/s/sqrt(Hz)",
    "odr": "Hz",
    "bandwidth": "Hz",
    "full_scale": "rad/s",
    "count": "rad/s",
    "skew": "1",
    "wander": "1/sqrt(s)",
}  # of the quantities whose unit is not s
MAX_ODR_HZ = 1e5
# Largest sizes of a cause's values, by unit. Real ones are thousands of times smaller.
MAX_CAUSE_SIZES = {"1": 1e3, "rad": 7.0, "rad/s": 1e3, "Hz": MAX_ODR_HZ, "s": 1e7, "K": 1e3}
CAUSE_UNITS = frozenset(
    {"1", "1/K", "Hz", "K", "degC", "rad", "rad/s", "rad/s/(m/s^2)", "rad/s/K", "rad/s/K^2"}
    | {"rad/s/sqrt(s)", "rad/s^2", "s", "s/rad", "s^2", "s^2/rad^2", "samples"}
)
MAX_SKEW = 0.5  # relative
MAX_LATENCY_S = 10.0


def parse_twin(text: str | bytes, name: str, error: type[GyrorigError] = UsageError) -> Twin:
    """Return the section `twin` of a rig file. The rest of the file is not checked.

    Args:
        text: the rig file.
        name: its name in an error.
        error: the class of error to raise, by who must act.

    Raises:
        GyrorigError: of the given class; there is no such section, or it is not valid.
    """
    document = parse_yaml(text, name, error, RIG_SCHEMA)
    section = document.get("twin") if isinstance(document, dict) else None
    if section is None:
        raise error(
            f"{name} is not the file of a twin, because it has no key `twin`",
            "give the file twin.yaml that `gyrorig twin` has written",
        )
    place = f"{name}: twin"
    twin = convert_document(section, Twin, place, error)
    check_twin(twin, place, error)
    return twin


def twin_to_plain(twin: Twin) -> dict[str, Any]:
    """Return the section as mappings, lists and scalars, keys in the order of the schema."""
    plain: dict[str, Any] = msgspec.to_builtins(twin)
    for board in plain["boards"].values():
        if not board["later_temperatures"]:
            del board["later_temperatures"]  # a key that older programs do not know
    return plain


def check_twin(twin: Twin, name: str, error: type[GyrorigError] = UsageError) -> None:
    """Check what the types of a section cannot express.

    Args:
        twin: the section.
        name: the section's name in an error.
        error: the class of error to raise, by who must act.

    Raises:
        GyrorigError: of the given class; the text gives the place and the reason.
    """
    recordings = [recording.name for recording in twin.recordings]
    for recording in twin.recordings:
        if recording.end_s <= recording.begin_s:
            raise error(
                f"{name}: the recording {recording.name} does not end after its begin",
                "write the times of its first and last sample, in s",
            )
    _check_link(twin.link, f"{name}: link", error)
    if twin.unit is not None:
        _check_units(twin.unit, f"{name}: unit", error)
        _check_latencies(twin.unit, ("answer_time", "start_delay"), f"{name}: unit", error)
        _check_clock(twin.unit.counter, f"{name}: unit: counter", error)
    for board_id, board in twin.boards.items():
        _check_board(board, f"{name}: boards: {board_id}", error)
    for number, cause in enumerate(twin.causes, start=1):
        place = f"{name}: causes, entry {number} ({cause.cause})"
        if cause.board is not None and cause.board not in twin.boards:
            hint = did_you_mean(cause.board, twin.boards)
            raise error(
                f"{place} is on the board {cause.board!r:.40}, which the twin does not have",
                hint or "write the id of a board under `boards`, or null",
            )
        if cause.recording is not None and cause.recording not in recordings:
            hint = did_you_mean(cause.recording, recordings)
            raise error(
                f"{place} happened in {cause.recording!r:.60}, which is not under `recordings`",
                hint or "write the name of a recording under `recordings`, or null",
            )
        for key, size in cause.parameters.items():
            if size.unit not in CAUSE_UNITS:
                raise error(
                    f"{place}: {key} has the unit {size.unit!r:.40}, which is not the SI unit of a "
                    "cause",
                    "convert the value to the unit in the findings of `gyrorig explain`",
                )
            largest = MAX_CAUSE_SIZES.get(size.unit)
            if largest is not None and abs(size.value) > largest:
                raise error(
                    f"{place}: {key} is {size.value:g} {size.unit}, which no rig can have",
                    f"write a value of at most {largest:g} {size.unit}",
                )
    if twin.posterior is not None:
        _check_posterior(twin, f"{name}: posterior", error)


def find_quantity(twin: Twin, path: str) -> tuple[Scalar | Vector | Matrix, tuple[int, ...]] | None:
    """Return the quantity that a name of the posterior means, and the indices in its value.

    None if the section has no such value.
    """
    kind, _, rest = path.partition(".")
    if kind == "causes":
        number, _, parameter = rest.partition(".")
        if not number.isdecimal() or int(number) >= len(twin.causes):
            return None
        scalar = twin.causes[int(number)].parameters.get(parameter)
        return None if scalar is None else (scalar, ())
    owner: Any = {"unit": twin.unit, "link": twin.link}.get(kind)
    if kind == "boards":
        board_id, _, rest = rest.partition(".")
        owner = twin.boards.get(board_id)
    words = rest.split(".")
    while words and isinstance(owner, msgspec.Struct) and not _is_quantity(owner):
        owner = getattr(owner, words.pop(0), None)
    if not _is_quantity(owner):
        return None
    rank = 0 if isinstance(owner, Scalar) else 1 if isinstance(owner, Vector) else 2
    if len(words) != rank or any(word not in ("0", "1", "2") for word in words):
        return None
    return owner, tuple(int(word) for word in words)


def _is_quantity(value: object) -> bool:
    return isinstance(value, Scalar | Vector | Matrix)


def _check_units(part: msgspec.Struct, place: str, error: type[GyrorigError]) -> None:
    for key in part.__struct_fields__:
        quantity = getattr(part, key)
        unit = UNITS.get(key, "s")
        if _is_quantity(quantity) and quantity.unit != unit:
            raise error(
                f"{place}: {key} has the unit {quantity.unit!r}, which must be {unit!r}",
                "convert the value to this unit",
            )


def _check_latencies(
    part: msgspec.Struct, keys: tuple[str, ...], place: str, error: type[GyrorigError]
) -> None:
    for key in keys:
        latency: Scalar | None = getattr(part, key)
        if latency is not None and not 0.0 <= latency.value <= MAX_LATENCY_S:
            raise error(
                f"{place}: {key} is {latency.value:g} s",
                f"write a time of 0 to {MAX_LATENCY_S:g} s",
            )


def _check_clock(clock: TwinClock, place: str, error: type[GyrorigError]) -> None:
    _check_units(clock, place, error)
    if clock.skew is not None and abs(clock.skew.value) > MAX_SKEW:
        raise error(
            f"{place}: skew is {clock.skew.value:g}",
            f"write a relative error of the clock from -{MAX_SKEW:g} to {MAX_SKEW:g}",
        )


def _check_link(link: TwinLink, place: str, error: type[GyrorigError]) -> None:
    _check_units(link, place, error)
    latencies = tuple(key for key in link.__struct_fields__ if key != "stall_interval")
    _check_latencies(link, latencies, place, error)
    if link.stall_interval is not None and link.stall_interval.value < 0.0:
        raise error(f"{place}: stall_interval is negative", "write 0 for a link without stalls")
    shortest, longest = link.stall_shortest, link.stall_longest
    if shortest is not None and longest is not None and shortest.value > longest.value:
        raise error(
            f"{place}: stall_shortest is longer than stall_longest", "exchange the two values"
        )


def _check_board(board: TwinBoard, place: str, error: type[GyrorigError]) -> None:
    _check_units(board, place, error)
    _check_clock(board.clock, f"{place}: clock", error)
    _check_latencies(board, ("stamp_jitter",), place, error)
    if board.odr is not None and board.odr.value > MAX_ODR_HZ:
        raise error(
            f"{place}: odr is {board.odr.value:g} Hz", f"write a rate of at most {MAX_ODR_HZ:g} Hz"
        )
    for key in ("odr", "bandwidth", "full_scale", "count"):
        quantity: Scalar | None = getattr(board, key)
        if quantity is not None and quantity.value <= 0.0:
            raise error(f"{place}: {key} is not positive", "write a positive value")
    for key in ("noise_density", "bias_instability", "rate_random_walk", "noise_floor"):
        levels: Vector | None = getattr(board, key)
        if levels is not None and min(levels.value) < 0.0:
            raise error(f"{place}: {key} is negative", "write levels of 0 or more")
    (a, b, c), (d, e, f), (g, h, i) = board.gain.value
    if abs(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)) < 1e-9:
        raise error(
            f"{place}: gain is singular",
            "write the matrix STM of a calibration that determines all three axes",
        )
    first = () if board.temperature is None else (board.temperature,)
    for curve in (*first, *board.later_temperatures.values()):
        _check_temperature(curve, place, error)


def _check_temperature(curve: TwinTemperature, place: str, error: type[GyrorigError]) -> None:
    times = curve.time_s
    if len(times) != len(curve.degc):
        raise error(
            f"{place}: temperature has {len(times)} times and {len(curve.degc)} values",
            "write one value per time",
        )
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise error(f"{place}: the times of temperature do not increase", "sort the points")


def _check_posterior(twin: Twin, place: str, error: type[GyrorigError]) -> None:
    posterior = twin.posterior
    if posterior is None:
        return
    names, rows = posterior.names, posterior.covariance
    if len(set(names)) != len(names):
        raise error(f"{place} has a name twice", "write each name once")
    for path in names:
        if find_quantity(twin, path) is None:
            raise error(
                f"{place}: no value of the twin has the name {path!r:.80}",
                "write names such as boards.ID.gain.0.2 or causes.0.gap.pan",
            )
    size = len(names)
    if len(rows) != size or any(len(row) != size for row in rows):
        raise error(
            f"{place}: the covariance is not a matrix of {size} rows and columns",
            "write one row and one column per name",
        )
    for k in range(size):
        if rows[k][k] < 0.0:
            raise error(f"{place}: the variance of {names[k]} is negative", "write 0 or more")
        for m in range(k):
            scale = (rows[k][k] * rows[m][m]) ** 0.5
            if abs(rows[k][m] - rows[m][k]) > SYMMETRY_TOLERANCE * scale:
                raise error(
                    f"{place}: the covariance of {names[m]} and {names[k]} is not symmetric",
                    "write the same value in both places",
                )
            if abs(rows[k][m]) > (1.0 + SYMMETRY_TOLERANCE) * scale:
                raise error(
                    f"{place}: the covariance of {names[m]} and {names[k]} is larger than their "
                    "variances allow",
                    "write a covariance matrix",
                )
