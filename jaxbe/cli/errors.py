"""What the user can mend."""


class InputError(Exception):
    """Bad input; the message is one line for the user."""

    def __init__(self, message: object) -> None:
        super().__init__(" ".join(str(message).split()))
