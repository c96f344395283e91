"""Prediction and search of motion programs, before any motor moves.

What to use when: `rig_model.load_rig` for the rig; `prediction.predict_program` for the standard
uncertainties of a program; `program_search.find_program` for the best program in a given time;
`detectability.predict_detectability` for the causes that a program detects. `program_family` has
the programs that are searched, `program_timeline` simulates their execution.
"""
