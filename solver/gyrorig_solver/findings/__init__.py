"""The findings of `gyrorig explain`: document, texts and files.

What to use when: `findings_builder.build_findings_document` to make a document,
`findings_document` for its schema, to read and to write it, `findings_wording` for texts,
`findings_files.write_findings` for the folder with document, report and figures.
"""
