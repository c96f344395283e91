"""Make the targets importable as `tests.fuzz`, for pytest and for the fuzzer."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
