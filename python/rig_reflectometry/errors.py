"""What the package raises. Every exception is a RigError and one of Python's own kinds."""


class RigError(Exception):
    """Anything that the package refuses or cannot do."""


class InputError(RigError, ValueError):
    """An argument that cannot be used: shape, type, range, NaN, a name that stands for nothing."""


class FileError(RigError, OSError):
    """A file that cannot be read or written, is damaged, or is not what its name promises."""


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
