"""Texts of findings: verdicts, causes, sizes and limits, for terminals and reports.

What to use when: `findings_summary` for a terminal; the other functions for one part of a page.
Files keep SI units; each parameter has one unit in all texts.
"""

import math
from types import MappingProxyType

from gyrorig_solver.discover.attitude.attitude_terms import ReferenceSmoothing
from gyrorig_solver.findings.findings_document import (
    CauseEntry,
    ChangeEntry,
    DetectableEntry,
    FindingsDocument,
    SizeEntry,
)
from gyrorig_solver.model import (
    DEG_PER_RAD,
    cause_display_unit,
    format_quantity,
    format_short,
    plural,
)
from gyrorig_solver.model.catalogue import catalogue

WAVE_PARTS = ("cosine", "sine")  # parameters of a wave; a turn of its zero exchanges them

# Verdict of the document: title and sentence.
VERDICTS = MappingProxyType(
    {
        "adequate": (
            "No error found",
            "The base model explains the data, and the residual is noise.",
        ),
        "explained": (
            "Problem found",
            "The base model does not fit the data. The causes below explain the whole residual.",
        ),
        "unexplained": (
            "Not fully explained",
            "No known cause explains a part of the residual. That part is shown below.",
        ),
    }
)
# Causes that only the checks of the raw stream or of a reference of attitudes find.
_OTHER_TITLES = {
    "stuck_axis": "An axis is stuck",
    "board_restart": "The board restarted",
    ReferenceSmoothing.cause: ReferenceSmoothing.title,
}
MAX_NAMES_PER_LINE = 8
MAX_CAUSES_IN_HEADING = 3
MIN_SEPARATION_PROBABILITY = 0.5  # of one name; less is not called a separation
MAX_STATED_PERCENT = 99.0  # a model cannot promise more
MIN_P_VALUE = 1e-12  # smaller ones are not told apart

_LIMITED_REFERENCE = (
    "No error found, few tests possible",
    "The reference has no motion of a unit and no attitudes. The program only checked the samples.",
)


def verdict_words(document: FindingsDocument) -> tuple[str, str]:
    """Return the verdict's title and sentence."""
    if document.verdict == "adequate" and not document.minimal_detectable:
        return _LIMITED_REFERENCE
    return VERDICTS[document.verdict]


def cause_title(cause: str) -> str:
    """Return the title of a cause for a report."""
    if cause in catalogue():
        return catalogue()[cause].title
    return _OTHER_TITLES.get(cause, cause.replace("_", " ").capitalize())


def cause_remedy(cause: str, link: str = "serial") -> str:
    """Return what to do about a cause, or "" where nothing is known.

    Args:
        cause: the id of the cause.
        link: on which the samples arrived.
    """
    if cause in catalogue():
        return catalogue()[cause].remedy_for(link)
    return ReferenceSmoothing.remedy if cause == ReferenceSmoothing.cause else ""


def size_text(cause: str, name: str, size: SizeEntry) -> str:
    """Return a value with its standard uncertainty and unit.

    Args:
        cause: the id of the cause.
        name: the parameter, with its component.
        size: its entry in a document.
    """
    if size.value is None:
        return "unknown"
    factor, unit = cause_display_unit(cause, name.partition(".")[0], size.unit)
    if not size.std:
        return f"{format_short(size.value * factor)} {unit}".strip()
    value, std = format_quantity(size.value * factor, size.std * factor)
    return f"{value} ± {std} {unit}".strip()


def amount_text(cause: str, value: float | None, unit: str) -> str:
    """Return a size of a cause with its unit."""
    if value is None:
        return "any"
    factor, word = cause_display_unit(cause, "", unit)
    return f"{format_short(value * factor)} {word}".strip()


def place_text(where: str | None, recording: str | None = None) -> str:
    """Return ", on tilt" for a place, ", in a.mcap" for one of several recordings, or both."""
    where_text = f", on {where}" if where and where != "all" else ""
    return where_text + (f", in {recording}" if recording else "")


def cause_headline(cause: CauseEntry) -> str:
    """Return a cause's title and place."""
    return cause_title(cause.cause) + place_text(cause.where, cause.recording)


def lower_title(name: str) -> str:
    """Return a cause's title as a part of a sentence."""
    title = cause_title(name)
    return title[:1].lower() + title[1:]


def named_causes_text(document: FindingsDocument) -> str:
    """Return a colon and the first three causes of a document, and the number of the others."""
    if not document.causes:
        return ""
    texts = []
    for cause in document.causes[:MAX_CAUSES_IN_HEADING]:
        name = lower_title(cause.cause) + place_text(cause.where, cause.recording)
        texts.append(", ".join(filter(None, (name, main_size_text(cause)))))
    other_count = len(document.causes) - len(texts)
    if other_count:
        texts.append(f"and {plural(other_count, 'other cause')}")
    return f": {'; '.join(texts)}"


def main_size_text(cause: CauseEntry) -> str:
    """Return the most significant size of a cause, such as "0.101 ± 0.001 deg"; "" for none."""
    term = catalogue().get(cause.cause)
    # A time or a shape can be more significant than the size, but it is no size.
    others = {p.name for p in term.parameters if p.role != "size"} if term is not None else set()
    sizes = [
        (name, size)
        for name, size in cause.parameters.items()
        if size.value is not None and size.std and name.split(".")[0] not in others
    ]
    if not sizes:
        return ""
    name, largest = max(sizes, key=lambda named: abs(named[1].value or 0.0) / (named[1].std or 1.0))
    wave = _amplitude(cause, name.partition(".")[2])
    if wave is not None and name.partition(".")[0] in WAVE_PARTS:
        return f"amplitude {size_text(cause.cause, name, wave).removeprefix('+')}"
    return size_text(cause.cause, name, largest).removeprefix("+")


def _amplitude(cause: CauseEntry, place: str) -> SizeEntry | None:
    """Return the amplitude of a wave, with the largest uncertainty that any correlation allows.

    None if the cause has no cosine and sine at this place.
    """
    parts = [cause.parameters.get(f"{part}.{place}" if place else part) for part in WAVE_PARTS]
    known = [(part.value, part.std, part.unit) for part in parts if part is not None]
    if len(known) < len(WAVE_PARTS):
        return None
    values, stds, units = zip(*known, strict=True)
    amplitude = math.hypot(*(value or 0.0 for value in values))
    if amplitude == 0.0:
        return None
    products = (abs(value or 0.0) * (std or 0.0) for value, std in zip(values, stds, strict=True))
    return SizeEntry(amplitude, sum(products) / amplitude, units[0])


def parameter_bias_sigma(document: FindingsDocument, cause: CauseEntry) -> float | None:
    """Return by how many standard uncertainties ignoring a cause biases the worst parameter."""
    if _is_only_cause(document, cause):
        return max(change.sigma for change in document.effect_on_calibration)
    return cause.harm_sigma


def parameter_changes(document: FindingsDocument, cause: CauseEntry) -> list[ChangeEntry]:
    """Return how a cause changes the calibration.

    For the only cause of a document, these are the differences of the two fits, with and without
    it. The changes by one of several causes are taken to first order.
    """
    whole_fit = _is_only_cause(document, cause)
    return document.effect_on_calibration if whole_fit else cause.effect_on_calibration


def _is_only_cause(document: FindingsDocument, cause: CauseEntry) -> bool:
    """Return whether the changes of the whole fit are those by a cause.

    A cause that the samples or the gain show is no term of the fit, so it has no changes.
    """
    is_in_fit = cause.harm_sigma is not None
    return is_in_fit and len(document.causes) == 1 and bool(document.effect_on_calibration)


def p_value_text(p_value: float) -> str:
    """Return "p = 0.0012", or "p < 1e-12"."""
    return f"p < {MIN_P_VALUE:.0e}" if p_value < MIN_P_VALUE else f"p = {p_value:.2g}"


def findings_summary(document: FindingsDocument) -> str:
    """Return verdict, causes, residual and limits as lines for a terminal."""
    lines = [_heading(document)]
    for cause in document.causes:
        lines += _cause_lines(document, cause)
    unexplained = document.unexplained
    if unexplained is not None:
        p_value = "" if unexplained.p_value is None else f" ({p_value_text(unexplained.p_value)})"
        lines.append(
            "  ? no cause explains a part of the residual, which depends "
            f"{unexplained.best_covariate}{p_value}"
        )
        if unexplained.harm:
            lines.append(f"    {unexplained.harm}")
    for name, gain in (
        ("held-out windows", document.gain),
        ("held-out recording", document.elsewhere),
    ):
        if gain is not None and gain.held_out_log_likelihood is not None:
            lines.append(
                f"  {name:<20}  log-likelihood {gain.held_out_log_likelihood:+.1f} nats; residual "
                f"{deg_per_s_text(gain.residual_rms_before)} to "
                f"{deg_per_s_text(gain.residual_rms_after)} deg/s"
            )
    detectable = [limit for limit in document.minimal_detectable if limit.by_sigma is not None]
    for limit in detectable[:3]:
        lines.append(
            f"  not detectable here   {limit.cause}{_limit_text(limit)} "
            f"would bias {limit.would_move} by up to {limit.by_sigma:.1f} standard uncertainties"
        )
    if document.not_testable:
        names = list(dict.fromkeys(entry.cause for entry in document.not_testable))
        if len(names) > MAX_NAMES_PER_LINE + 1:
            names[MAX_NAMES_PER_LINE:] = [f"and {len(names) - MAX_NAMES_PER_LINE} more"]
        lines.append(f"  not testable here     {', '.join(names)}")
    lines += [f"  note: {text}" for text in document.remarks]
    return "\n".join(lines)


def next_experiment_lines(document: FindingsDocument) -> list[str]:
    """Return sentences on the proposed program, without its file; [] where no set is stated."""
    proposed = document.next_experiment
    if proposed is None:
        return []
    lines: list[str] = []
    open_pairs: list[str] = []
    hidden: list[str] = []
    for pair in proposed.pairs:
        is_alone = len(pair.causes) == 1
        names = pair.causes[0] if is_alone else " from ".join(pair.causes)
        is_hopeless = not pair.probability or pair.probability < MIN_SEPARATION_PROBABILITY
        if proposed.program is None or is_hopeless:
            (hidden if is_alone else open_pairs).append(names)
            continue
        purpose = f"shows {names} of the typical size" if is_alone else f"separates {names}"
        lines.append(
            f"It {purpose}: expected log Bayes factor "
            f"{format_short(pair.expected_log_bayes_factor or 0.0)}, "
            f"{'found' if is_alone else 'one name'} with a probability "
            f"of {_percent_text(pair.probability or 0.0)}."
        )
    limit = "" if proposed.longest_s is None else f" of at most {proposed.longest_s:g} s"
    for verb, names_left in (("separate", open_pairs), ("show", hidden)):
        if names_left:
            lines.append(f"No motion program{limit} is sure to {verb} {', '.join(names_left)}.")
    return lines


def _percent_text(probability: float) -> str:
    percent = 100.0 * probability
    return "over 99 %" if percent > MAX_STATED_PERCENT else f"{percent:.0f} %"


def _limit_text(limit: DetectableEntry) -> str:
    place = "" if limit.where in (None, "all") else f" ({limit.where})"
    if limit.size is None:
        return f"{place} at any size; it"
    return f"{place} below {amount_text(limit.cause, limit.size, limit.unit)}; a smaller size"


def _heading(document: FindingsDocument) -> str:
    board = f"{document.board.id} ({document.board.sensor or 'unknown sensor'})"
    return f"{board}: {verdict_words(document)[0].lower()}{named_causes_text(document)}"


def _cause_lines(document: FindingsDocument, cause: CauseEntry) -> list[str]:
    name = " or ".join([cause.cause, *cause.one_of])
    lines = [f"  ! {name}{place_text(cause.where, cause.recording)}: {cause.evidence.seen_as}"]
    sizes = ", ".join(
        f"{name} {size_text(cause.cause, name, size)}" for name, size in cause.parameters.items()
    )
    bias_sigma = parameter_bias_sigma(document, cause)
    if bias_sigma is not None:
        sizes += (
            "; without this cause in the fit, a parameter is wrong by up to "
            f"{format_short(bias_sigma)} standard uncertainties"
        )
    lines.append(f"    {sizes}")
    if cause.remedy:
        lines.append(f"    what to do: {cause.remedy}")
    return lines


def deg_per_s_text(value: float | None) -> str:
    """Return a rate in deg/s, without its unit."""
    return "?" if value is None else format_short(value * DEG_PER_RAD)
