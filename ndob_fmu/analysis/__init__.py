"""What is known about a model before anything runs: the checks, and the two designs that the commands print."""
