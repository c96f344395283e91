"""The targets are imported as `tests.fuzz`, by pytest as by the fuzzer itself."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
