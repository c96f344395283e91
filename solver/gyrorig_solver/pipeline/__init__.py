"""The pipeline from recordings to documents: load, prepare, fit, search for causes, store.

The command line and the batch both call these modules. `board_data.load_board` reads a board
once; every later step takes its `BoardData`.

What to use when: `solve_board.solve_and_store` for a calibration in a store,
`explain_board.explain_boards` for findings, `fit_board.solve_recordings` for a fit alone.
"""
