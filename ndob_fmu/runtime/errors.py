"""Errors that a design or a running observer can raise; also carried inside every FMU."""

from __future__ import annotations


class NdobError(Exception):
    """Base of every error this package raises; ``exit_code`` is what the command line returns for it."""

    exit_code = 2

    @classmethod
    def report(cls, where: str, *, expected: str, received: str, likely: str = "") -> NdobError:
        """Return the error with the one-line message that every bad input ends in."""
        cause = f"; likely cause: {likely}" if likely else ""
        return cls(f"{where}: expected {expected}, received {received}{cause}")


class DesignError(NdobError):
    """The numbers given admit no gain that could be trusted."""

    exit_code = 1


class AssumptionError(NdobError):
    """An assumption of the paper does not hold for the system."""

    exit_code = 1


class IntegrationError(NdobError):
    """The plant's equations cannot be integrated further."""

    exit_code = 1
