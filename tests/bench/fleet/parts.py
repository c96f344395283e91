"""What boards of a fleet differ by, and what changes on a board from night to night.

One table for both makers, so that the rows of one can be held against the recordings of the
other. By families of parameters, in the parameter's unit, one standard deviation.
"""

# What boards of one kind differ by. The parts' data sheets give limits, not spreads (I3G4250D:
# scale +-15 %, zero rate +-10 dps): a maker's own spread is some tenth of them. A mount is
# screwed on by hand.
SPREAD = {"bias": 5e-3, "scale": 1e-2, "nonorthogonality": 4e-3, "misalignment": 8e-3, "time": 1e-3}

# What the same board shows differently on another night: another turn-on, put into its fixture
# again, other stress in the package.
SCATTER = {
    "bias": 4e-4,
    "scale": 2e-4,
    "nonorthogonality": 2e-4,
    "misalignment": 3e-4,
    "time": 1e-4,
}

# What a calibration leaves open: the middle of what `gyrorig solve` states for the recordings of
# `make --program quick`; see docs/fleet.md.
ERROR = {"bias": 1e-4, "scale": 2e-4, "nonorthogonality": 3e-4, "misalignment": 3e-4, "time": 2e-4}
