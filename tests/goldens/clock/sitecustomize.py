"""Fixed time of day and host name, for a process that makes a recording of the golden set.

What to use when: put this folder into PYTHONPATH and the time into GOLDENS_CLOCK_NS. Python
imports `sitecustomize` at its start. Only the standard library is changed, so this works with
every version of the programs. Monotonic clocks stay as they are: they measure waiting.
"""

import os
import socket
import time

HOST = "golden-host"
_FIXED_NS = os.environ.get("GOLDENS_CLOCK_NS")

if _FIXED_NS:
    _now_ns = int(_FIXED_NS)
    time.time_ns = lambda: _now_ns
    time.time = lambda: _now_ns * 1e-9
    socket.gethostname = lambda: HOST
