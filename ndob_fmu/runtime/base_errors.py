"""Errors that a design or a running observer can raise; also carried inside every FMU."""

from __future__ import annotations

from collections.abc import Sequence

MESSAGE_LIMIT = 300  # characters: a message is one line that a person reads at a prompt
_CUT = " … "


class NdobError(Exception):
    """Base of every error this package raises; ``exit_code`` is what the command line returns for it.

    The message is one line of at most ``MESSAGE_LIMIT`` characters; a longer text loses its middle.
    """

    exit_code = 2

    def __init__(self, message: str = "") -> None:
        super().__init__(shortened(message))

    @classmethod
    def report(cls, where: str, *, expected: str, received: str, likely: str = "") -> NdobError:
        """Return the error with the one-line message that every bad input ends in.

        Where the message would be too long, the longest of the four texts lose their middle.
        """
        words = (": expected ", ", received ", "; likely cause: " if likely else "")
        texts = (where, expected, received, likely)
        longest = _longest(texts, MESSAGE_LIMIT - len("".join(words)))
        where, expected, received, likely = (shortened(text, longest) for text in texts)
        return cls(f"{where}{words[0]}{expected}{words[1]}{received}{words[2]}{likely}")


def shortened(text: str, limit: int = MESSAGE_LIMIT) -> str:
    """Return a text as one line of at most ``limit`` characters, without its middle where it is longer."""
    line = " ".join(text.splitlines())
    if len(line) <= limit:
        return line
    kept = limit - len(_CUT)
    return line[: kept - kept // 2] + _CUT + line[len(line) - kept // 2 :]


def _longest(texts: Sequence[str], room: int) -> int:
    """Return how long the longest texts may be so that all of them fit into ``room`` characters together."""
    for position, length in enumerate(sorted(map(len, texts))):
        share = room // (len(texts) - position)
        if length > share:
            return share
        room -= length
    return max(map(len, texts))


class DesignError(NdobError):
    """No gain, or none that is accurate enough, can be computed from the given numbers."""

    exit_code = 1


class AssumptionError(NdobError):
    """An assumption of the paper does not hold for the system."""

    exit_code = 1


class IntegrationError(NdobError):
    """The plant's equations cannot be integrated further."""

    exit_code = 1
