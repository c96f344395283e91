"""The findings of `gyrorig explain`: document, texts and files.

What to use when: `findings_builder.build_findings_document` to make a document,
`findings_document` for its schema, to read and to write it, `findings_wording` for texts,
`findings_files.write_findings` for the folder with document, report and figures.
"""

from gyrorig_solver.findings.findings_builder import build_findings_document
from gyrorig_solver.findings.findings_document import FindingsDocument
from gyrorig_solver.findings.findings_files import write_findings
from gyrorig_solver.findings.findings_wording import findings_summary

__all__ = [
    "FindingsDocument",
    "build_findings_document",
    "findings_summary",
    "write_findings",
]
