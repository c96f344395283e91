"""Calibration documents: building, reading and storing them, and their texts.

What to use when: `calibration_builder.build_calibration` for the document of a fit;
`calibration_document.parse_calibration` to read one; `calibration_store` for versions on disk;
`verdict` for the verdict; `calibration_wording` and `calibration_summary` for texts;
`paper_calibration` for the paper's method. `pipeline.solve_board` does all of it for a recording.

It exports no names itself: `apply` reads a document with numpy alone, and the builder needs scipy.
"""
