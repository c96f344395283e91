"""Injection of causes into an emulated rig: the catalogue, requests as text, sampled sizes.

What to use when: `parse_injection` for a request as text, `sample_injected_causes` for the causes
with their parameters, `apply_causes` for the hooks of a rig; `CAUSES` for names, units and sizes.
A cause is one class in a separate file, see `causes.cause.Cause`.
"""

from gyrorig_daemon.emulator.causes.cause import Cause, InjectedCause, Quantity
from gyrorig_daemon.emulator.injection.cause_catalogue import CAUSES
from gyrorig_daemon.emulator.injection.cause_sampling import apply_causes, sample_injected_causes
from gyrorig_daemon.emulator.injection.injection_request import RANDOM, parse_injection

__all__ = [
    "CAUSES",
    "RANDOM",
    "Cause",
    "InjectedCause",
    "Quantity",
    "apply_causes",
    "parse_injection",
    "sample_injected_causes",
]
