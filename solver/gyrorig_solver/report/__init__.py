"""Reports: one self-contained HTML page per calibration or per findings document.

What to use when: `calibration_page.render_calibration` for a calibration report,
`findings_page.render_findings` for an explain report. The view modules decide texts and units, the
figure modules draw, the templates place and escape.
"""
