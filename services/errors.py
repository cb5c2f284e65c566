"""The two ways in which work ends early: what the user must change, and what nobody can but a new start may."""


class UserError(ValueError):
    """What the user must mend. Its text is one line that says what is wrong, where, and how to mend it."""


class FatalError(RuntimeError):
    """What nobody can mend but a new start may: a device that is gone. Its text is one line."""
