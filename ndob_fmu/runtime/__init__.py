"""What runs inside an FMU: it imports NumPy and the standard library alone."""
