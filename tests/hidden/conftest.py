"""The page of scores is checked with the scripts of docs/, which are no installed package."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
