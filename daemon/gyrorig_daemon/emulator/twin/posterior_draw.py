"""Draws from the posterior of a twin."""

from typing import Any

import msgspec
import numpy as np

from gyrorig_protocol.twin import Matrix, Scalar, Twin, Vector, find_quantity

_DRAW_STREAM = 0x4452_4157  # different from the other streams of a seed
# A normal draw of these can be negative, which means nothing.
_NOT_NEGATIVE = frozenset(
    {
        "noise_density", "bias_instability", "rate_random_walk", "noise_floor", "stamp_jitter",
        "wander",
        "answer_time", "start_delay", "floor", "jitter", "stall_interval", "stall_shortest",
        "stall_longest", "write_floor", "write_jitter", "odr", "bandwidth", "full_scale", "count",
    }
)  # fmt: skip
_SMALLEST_SHARE = 0.1  # of the best value, for values that are not negative
_STALL_INTERVAL = "link.stall_interval"


def draw_twin(twin: Twin, number: int) -> Twin:
    """Return a twin with values drawn from its posterior.

    Values of `posterior` are drawn together, and other values with a standard deviation one by one.

    Args:
        twin: the best values.
        number: of the draw; the same number gives the same values. 0: the best values.
    """
    if number == 0:
        return twin
    rng = np.random.default_rng([number, _DRAW_STREAM])
    plain: Any = msgspec.to_builtins(twin)
    joint: set[str] = set()
    if twin.posterior is not None:
        joint = set(twin.posterior.names)
        deviations = _correlated(np.array(twin.posterior.covariance), rng)
        for path, deviation in zip(twin.posterior.names, deviations.tolist(), strict=True):
            _add(plain, path, deviation)
    for path, std in _single_values(twin):
        deviation = std * float(rng.standard_normal())  # always, so that draws stay comparable
        if path == _STALL_INTERVAL:
            plain["link"]["stall_interval"]["value"] = _draw_interval(twin, number)
        elif path not in joint:
            _add(plain, path, deviation)
    return msgspec.convert(plain, Twin)


def _draw_interval(twin: Twin, number: int) -> float:
    """Return a mean time between stalls, from the posterior of a Poisson process.

    A count k of stalls in a time T gives the value T / k and its deviation T / k^1.5. Without
    stalls the value is 0 and the deviation is T. The rate has a gamma distribution with the shape
    k + 1/2. Source: H. Jeffreys, "Theory of Probability", 3rd ed., 1961, section 3.1.
    """
    interval = twin.link.stall_interval
    if interval is None or not interval.std:
        return 0.0 if interval is None else interval.value
    rng = np.random.default_rng([number, _DRAW_STREAM, 1])
    count = (interval.value / interval.std) ** 2
    observed_s = interval.value * count if count else interval.std
    return float(observed_s / max(rng.gamma(count + 0.5), 1e-9))


def _correlated(covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return normal numbers with a covariance, (n,), which may be singular.

    The sizes of the variances differ by many orders, so the correlation is factorised.
    """
    std = np.sqrt(np.diagonal(covariance))
    scale = np.where(std > 0.0, std, 1.0)
    correlation = 0.5 * (covariance + covariance.T) / np.outer(scale, scale)
    variances, directions = np.linalg.eigh(correlation)
    draws = np.sqrt(np.maximum(variances, 0.0)) * rng.standard_normal(len(std))
    return np.asarray(scale * (directions @ draws))


def _single_values(twin: Twin) -> list[tuple[str, float]]:
    """Return the name and the standard deviation of each number that has one."""
    paths: list[tuple[str, float]] = []

    def visit(prefix: str, value: object) -> None:
        if isinstance(value, Scalar | Vector | Matrix):
            for index, std in np.ndenumerate(np.array(value.std, dtype=np.float64)):
                if value.std is not None and std > 0.0:
                    paths.append((".".join([prefix, *map(str, index)]), float(std)))
        elif isinstance(value, msgspec.Struct):
            for name in value.__struct_fields__:
                visit(f"{prefix}.{name}", getattr(value, name))

    for board_id, board in twin.boards.items():
        visit(f"boards.{board_id}", board)
    visit("unit", twin.unit)
    visit("link", twin.link)
    for number, cause in enumerate(twin.causes):
        for name, scalar in cause.parameters.items():
            visit(f"causes.{number}.{name}", scalar)
    return [(path, std) for path, std in paths if find_quantity(twin, path) is not None]


def _add(plain: Any, path: str, deviation: float) -> None:
    """Add to the number that a path of the posterior means, in a twin as plain values."""
    kind, _, rest = path.partition(".")
    if kind == "causes":
        number, _, name = rest.partition(".")
        owner, words = plain["causes"][int(number)]["parameters"][name], []
    else:
        owner, words = plain[kind], rest.split(".")
        if kind == "boards":
            owner = owner[words.pop(0)]
        name = ""
        while words and "value" not in owner:
            name = words.pop(0)
            owner = owner[name]
    if not words:
        owner["value"] = _moved(owner["value"], deviation, name)
        return
    row = owner["value"] = list(owner["value"])
    for word in words[:-1]:
        row[int(word)] = list(row[int(word)])
        row = row[int(word)]
    row[int(words[-1])] = _moved(row[int(words[-1])], deviation, name)


def _moved(value: float, deviation: float, name: str) -> float:
    moved = value + deviation
    return max(moved, _SMALLEST_SHARE * value) if name in _NOT_NEGATIVE else moved
