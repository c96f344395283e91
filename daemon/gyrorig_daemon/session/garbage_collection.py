"""Cyclic garbage collection, made rare, because almost nothing here is in a reference cycle.

What to use when: once in a process that records in real time, after everything is imported
and opened.

Samples and their messages are thousands of short-lived tuples per second. By default Python
looks for cycles every 700 of them, and from time to time through all objects. With 16 boards
at 800 Hz that was a quarter of the daemon's processor time (36 % of a core became 27 %).
"""

import gc

# A collection of so many new objects takes about 2 ms, about once per second. Full collections
# skip the objects that existed at the start.
THRESHOLDS = (50_000, 20, 100)


def collect_rarely() -> None:
    """Exempt all present objects from collection, and check new ones rarely."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*THRESHOLDS)
