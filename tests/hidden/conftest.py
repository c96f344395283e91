"""Add the checkout to the path: tests of the page of scores use the scripts of docs/."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
