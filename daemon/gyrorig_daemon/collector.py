"""Python's search for cyclic garbage, made rare: nearly nothing here is in a cycle.

What to use when: once in a process that records in real time, when everything is imported
and opened.

Samples and their messages are thousands of short-lived tuples a second. By default Python
looks for cycles every 700 of them, and now and then through everything that is held: with 16
boards at 800 Hz that was a quarter of the daemon's processor time (36 % of a core became 27).
"""

import gc

# A look at so many new objects takes about 2 ms, every second or so; the rare whole ones
# leave out what was there at the beginning.
THRESHOLDS = (50_000, 20, 100)


def look_rarely() -> None:
    """Set what is there aside, and look for cycles among new objects only, and rarely."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*THRESHOLDS)
