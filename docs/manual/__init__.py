"""The manual: `make docs` makes it of the pages in docs, of lists of the program and of sources."""
