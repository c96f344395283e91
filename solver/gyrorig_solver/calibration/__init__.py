"""From a fit to a calibration that others can rely on.

What to use when: `solving.solve_into` for everything at once; `build.calibration_of` for
a document of a fit; `document.parse_calibration` to read one back; `store` for versions;
`trust` for the verdict; `wording` and `summary` for people; `paper` for the paper's method.
"""
