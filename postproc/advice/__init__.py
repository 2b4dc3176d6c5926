"""Which theory or run is accurate enough, and how long a run has to be."""
