"""Attacks on the program: seeded, run by hand for minutes, a few of each within the tests."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))  # where `postproc` is
