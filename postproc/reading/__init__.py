"""Results files of the program."""
