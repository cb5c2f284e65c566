"""The two ways in which work ends early: by what the user has to change, and by what only a restart can fix."""


class UserError(ValueError):
    """A mistake that the user can fix. Its text is one line: what is wrong, where, and how to fix it."""


class FatalError(RuntimeError):
    """A failure that only a restart can fix, such as a device that is gone. Its text is one line."""
