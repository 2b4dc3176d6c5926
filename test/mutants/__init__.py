"""Small faults in single lines of the physics; a test is to turn red."""
