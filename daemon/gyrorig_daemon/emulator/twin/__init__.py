"""An emulated rig from the section `twin` of its file, instead of from a seed.

What to use when: `draw_twin` for a draw from the posterior of the section; `make_twin_rig` for the
settings and the true parameters of the rig.
"""

from gyrorig_daemon.emulator.twin.posterior_draw import draw_twin
from gyrorig_daemon.emulator.twin.twin_rig import OTHER_RECORDING, TwinRig, make_twin_rig

__all__ = ["OTHER_RECORDING", "TwinRig", "draw_twin", "make_twin_rig"]
