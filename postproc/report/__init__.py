"""What there is to say of runs: a page, warnings, comparisons with theories."""
