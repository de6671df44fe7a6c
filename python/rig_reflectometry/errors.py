"""What the package raises. Every exception is a RigError and one of Python's own kinds."""


class RigError(Exception):
    """Anything that the package refuses or cannot do."""


class InputError(RigError, ValueError):
    """An argument that cannot be used: shape, type, range, NaN, a name that stands for nothing."""


class FileError(RigError, OSError):
    """A file that cannot be read or written, is damaged, or is not what its name promises.

    Where the system refused, errno, strerror and filename say how, as in every OSError.
    """

    def __str__(self):
        return str(self.args[0]) if self.args else ""

    def __reduce__(self):
        return file_error, (type(self), str(self), self.errno, self.strerror, self.filename)


def file_error(kind, message, errno, strerror, filename):
    """An exception of this kind of FileError, by what the library and the system say."""
    error = kind(message)
    error.errno, error.strerror, error.filename = errno, strerror, filename
    return error


class MissingFileError(FileError, FileNotFoundError):
    """A file or folder that is not there."""


class SceneError(RigError, ValueError):
    """A scene file that is wrong (with its line), or a scene of which the camera sees nothing."""


class SessionError(RigError, RuntimeError):
    """A folder that is no session, or a session that is damaged, unfinished or being written."""


class NoFitError(SessionError, LookupError):
    """A folder or session without a fit."""


class FitError(RigError, RuntimeError):
    """Images that cannot be the scene's, too little memory, equations without a solution."""
