"""Attacks on the program: seeded, run by hand for minutes, a few of each within the tests."""
