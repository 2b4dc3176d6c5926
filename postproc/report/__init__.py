"""Reports about runs: a page, warnings, comparisons with theories."""
