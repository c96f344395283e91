"""Search for paths on which eq. 12 alone gives the T_zy and M_yz of Table 3.

    python docs/paper/check_search.py

The search simulates a perfect gyro on ten paths, with six pan and eleven tilt amplitudes (the tilts
within a PTU-E46's range of -47 to +31 degrees), three readings of eq. 12 and both biases. It takes
about 15 s.
"""

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from docs.markdown import Block, number, show, table
from docs.paper.motion import along, calibrated, paths
from docs.paper.printed import GY80

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.paper.paper_angles import Composition
from gyrorig_solver.estimate.paper.paper_method import READING_OF_TABLE_3, BiasSource, PaperResult

PANS_DEG = (10.0, 20.0, 30.0, 45.0, 60.0, 90.0)
TILTS_DEG = (-45.0, -30.0, -20.0, -10.0, -5.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
COMPOSITIONS: tuple[Composition, ...] = ("printed", "right", "mechanism")
BIASES: tuple[BiasSource, ...] = ("static", "quasi_static")
SEARCH_RATE_HZ = 20.0  # a leg of 2 s still has 40 samples


def results() -> list[PaperResult]:
    """The paper's method on every combination."""
    paper_results = []
    for pan in PANS_DEG:
        for tilt in TILTS_DEG:
            for corners in paths(pan, tilt).values():
                motion = along(corners, rate_hz=SEARCH_RATE_HZ, static_s=1.0)
                rate = motion.body_rate_rad_s()
                for composition in COMPOSITIONS:
                    reading = replace(READING_OF_TABLE_3, composition=composition)
                    paper_results += [calibrated(motion, rate, bias, reading) for bias in BIASES]
    return paper_results


def full_rank(paper_results: list[PaperResult]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """S diagonals (k, 3), T_zy (k,) and M_yz (k,) of the combinations that give them."""
    factors = [(r.S, r.T, r.M) for r in paper_results]
    rows = [
        (*np.diag(S), T[2, 1], M[1, 2])
        for S, T, M in factors
        if S is not None and T is not None and M is not None
    ]
    values = np.array(rows)
    return values[:, :3], values[:, 3], values[:, 4]


def search() -> str:
    """Results of the search, compared with the GY80 of Table 3."""
    paper_results = results()
    scale, t_zy, m_yz = full_rank(paper_results)
    plausible = np.all((scale > 0.85) & (scale < 1.05), axis=1)
    near = (np.abs(np.abs(t_zy) - 0.15) < 0.04) & (np.abs(np.abs(m_yz) - 0.15) < 0.04)
    distance = min(float(np.linalg.norm(r.STM - GY80.STM)) for r in paper_results)
    identity = float(np.linalg.norm(np.eye(3) - GY80.STM))
    rows = [
        ["simulated combinations", str(len(paper_results))],
        ["combinations that give S, T and M (for the others eq. 8 has no result)", str(t_zy.size)],
        ["median absolute T_zy of these combinations", number(float(np.median(np.abs(t_zy))), 2)],
        [
            "those of them with S_x, S_y and S_z all between 0.85 and 1.05",
            str(np.count_nonzero(plausible)),
        ],
        ["largest M_yz with such S", number(float(np.abs(m_yz[plausible]).max()), 3)],
        [
            "combinations with such S, and with absolute T_zy and M_yz both within 0.04 of 0.15",
            str(np.count_nonzero(plausible & near)),
        ],
        [
            "smallest Frobenius distance between a simulated STM and that of the GY80",
            number(distance, 3),
        ],
        [
            "Frobenius distance between the identity matrix and the STM of the GY80",
            number(identity, 3),
        ],
    ]
    return table(["quantity", "value"], rows)


BLOCKS: dict[str, Block] = {"search": search}

if __name__ == "__main__":
    show(BLOCKS)
