"""How fast the program is: tables, changes between builds, ensembles on many ranks."""
