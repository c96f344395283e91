"""The report: one HTML page about one calibration.

What to use when: `html.render` on a `data.ReportData`. `view` decides what the page says,
`figures` draws, `page.html.j2` places and escapes.
"""
