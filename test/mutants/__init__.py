"""Small faults in single lines of the physics; a test is to turn red."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))  # where `postproc` is
