"""What is computed at every step: the two observers."""
