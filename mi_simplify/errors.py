"""
The errors a user can cause, each with the exit code that the command line gives it.

A message is one line: what was expected, what came, what to do. Anything that is not a
:class:`UserError` is a defect of ours and ends with exit code 1 and a traceback.
"""


class UserError(ValueError):
    """
    The user's input is wrong; the message is one clear line with the way out.
    """

    exit_code = 2


class AssetError(UserError):
    """
    A model or one of its textures is missing, unreadable, or holds nothing to render.
    """


class MeshError(UserError):
    """
    A mesh cannot be used: no faces, NaN positions, indices out of range, zero area.
    """


class ConfigError(UserError):
    """
    A configuration key is unknown, of the wrong type, or out of range; names the dotted path.
    """


class OutputError(UserError):
    """
    The output folder cannot be written, or already holds a run.
    """


class MemoryLimitError(UserError):
    """
    Something needs more memory than there is, or than ``--memory-limit`` leaves; it was not begun.
    """


class RuntimeUnavailable(UserError):
    """
    No usable LLVM, variant or optional package; the message names what to install.
    """


class Defect(RuntimeError):
    """
    A result is not what it should be, and not through the user's fault; everything that was written is kept.
    """

    exit_code = 1
