"""Numerical methods that know nothing of observers."""
