"""Errors that are the user's to mend.

Every error that bad input can cause is a `NolensError`: its message says what was given,
what would be accepted and what to do. The command line prints it and ends with exit code 2.
Anything else that is raised is a bug and ends with exit code 1.
"""


class NolensError(Exception):
    """Base of all errors caused by input rather than by the program."""


class FileError(NolensError):
    """A file that is missing, unreadable, no picture, or cannot be written."""


class DataError(NolensError):
    """Data that cannot be a measurement or a point spread function, or do not fit together."""


class OptionError(NolensError):
    """An option, parameter or configuration key with a value that cannot be used."""


class DivergenceError(NolensError):
    """An iteration that produced NaN or infinity."""


class CameraError(NolensError):
    """A camera that is not there, is in use, or stopped giving frames."""


class ScreenError(NolensError):
    """A screen before a camera that shows no pictures."""
