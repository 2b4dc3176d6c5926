"""The manual: `make docs` makes it from the pages in docs, lists of the program, and sources."""
