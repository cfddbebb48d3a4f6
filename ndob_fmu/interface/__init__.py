"""The variables that the FMUs show; carried inside every FMU."""
