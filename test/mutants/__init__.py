"""Small faults in single lines of the physics: does a test turn red?"""
