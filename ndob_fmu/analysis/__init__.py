"""What can be said about a model before anything runs: the checks, and the two designs for people."""
