"""The findings document: what `gyrorig explain` says of one board, and where it is written.

What to use when: `build.document_of` to make one, `document` for its shape, to write and to
read it, `writing.write_findings` for the folder that holds it with its figures.
"""
