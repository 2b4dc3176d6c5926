"""Frozen answers: odd tables, and what every engine finds on them."""
