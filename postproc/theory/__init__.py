"""Theories of a circuit, the paper's and later ones: flows, stationary states, lifetimes."""
