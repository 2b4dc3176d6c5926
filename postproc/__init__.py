"""Theory, figures, film and report of the battery program."""
