"""Pictures: of the paper, of a run, of a moment."""
