"""The errors that the user can mend: they carry a full sentence and never need a traceback."""


class RaytraceError(Exception):
    """Base of all errors that the command line prints as one message (exit code 1)."""


class ModelFileError(RaytraceError):
    """A `model.txt` that cannot be read; the message starts with `file:line:column:`."""


class ModelFileWarning(UserWarning):
    """A `model.txt` that is read although it is not quite right; the message starts with `file:line:column:`."""


class PictureError(RaytraceError):
    """A picture file that cannot be read or written, or does not fit the scene."""


class PictureWarning(UserWarning):
    """A picture that can be read, but whose pixels are not exactly what was rendered."""


class ParameterError(RaytraceError):
    """An unknown parameter name or a value that it cannot take."""
