"""Recordings of runs, the files they are kept in, and their plots."""
