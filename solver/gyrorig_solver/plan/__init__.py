"""Motion programs judged and made before any motor moves.

What to use when: `rig.load_rig` for what a rig's configuration says; `predict.predict` for
the standard deviations that a program will give; `search.find_program` for the program
that gives the least in a given time; `causes.foresee` for what a program shows of the
causes of an error. `family` holds what is searched, `timeline` how the
daemon carries a program out.
"""
