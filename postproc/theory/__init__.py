"""What the paper and later models say of a circuit: flows, stationary states, lifetimes."""
