"""The findings of `gyrorig explain`: document, texts and files.

What to use when: `findings_builder.build_findings_document` to make a document,
`findings_document` for its schema, to read and to write it, `findings_wording` for texts,
`findings_files.write_findings` for the folder with document, report and figures.
"""

from gyrorig_solver.findings.findings_builder import (
    UNEXPLAINED_FIGURE,
    build_findings_document,
    figure_key,
    figure_key_at,
    unexplained_bias_sigma,
)
from gyrorig_solver.findings.findings_document import CauseEntry, FindingsDocument, to_yaml
from gyrorig_solver.findings.findings_files import write_findings
from gyrorig_solver.findings.findings_wording import (
    amount_text,
    cause_title,
    findings_summary,
    next_experiment_lines,
    place_text,
)

__all__ = [
    "UNEXPLAINED_FIGURE",
    "CauseEntry",
    "FindingsDocument",
    "amount_text",
    "build_findings_document",
    "cause_title",
    "figure_key",
    "figure_key_at",
    "findings_summary",
    "next_experiment_lines",
    "place_text",
    "to_yaml",
    "unexplained_bias_sigma",
    "write_findings",
]
