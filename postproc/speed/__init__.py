"""Speed of the program: tables, changes between builds, ensembles on many ranks."""
