"""The fixed-step master algorithms."""
