"""Helpers of these tests are imported as `tests.packages` and `tests.systemd`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
