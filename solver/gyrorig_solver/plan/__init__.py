"""Prediction and search of motion programs, before any motor moves.

What to use when: `rig_model.load_rig` for the rig; `prediction.predict_program` for the standard
uncertainties of a program; `program_search.find_program` for the best program in a given time;
`detectability.predict_detectability` for the causes that a program detects;
`separation.propose_program` for a program that separates the causes that a search could not
separate. `program_family` has the programs that the planner searches, `program_timeline` simulates
their execution.
"""

from gyrorig_solver.plan.detectability import DetectabilityReport, predict_detectability
from gyrorig_solver.plan.prediction import Prediction, predict_program
from gyrorig_solver.plan.program_file import program_text, require_new_path, write_new_file
from gyrorig_solver.plan.program_search import PlanResult, find_program
from gyrorig_solver.plan.rig_model import RigModel, apply_limits, load_rig
from gyrorig_solver.plan.separation import MAX_PROGRAM_S, NextExperiment
from gyrorig_solver.plan.total_prediction import TotalPrediction, predict_total

__all__ = [
    "MAX_PROGRAM_S",
    "DetectabilityReport",
    "NextExperiment",
    "PlanResult",
    "Prediction",
    "RigModel",
    "TotalPrediction",
    "apply_limits",
    "find_program",
    "load_rig",
    "predict_detectability",
    "predict_program",
    "predict_total",
    "program_text",
    "require_new_path",
    "write_new_file",
]
