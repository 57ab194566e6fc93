"""What ends the command, in one line for the user."""

from jaxbe.cli.shown import shown

LONGEST = 1000
"""Messages that quote a whole file are cut in the middle, to so many characters."""


class InputError(Exception):
    """Bad input, which the user can mend."""

    def __init__(self, message: object) -> None:
        super().__init__(one_line(message))


class OutputError(Exception):
    """What was found cannot be handed over."""


def one_line(message: object) -> str:
    """A message in one line that a terminal can show."""
    line = " ".join(str(message).split())
    if len(line) > LONGEST:
        line = f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"
    return shown(line)
