"""
Names in a configuration that only code can know: looked up before a job begins.
"""

from __future__ import annotations

from ..config import Config
from ..export import WRITERS
from ..fitting.losses import image_loss
from ..machine.user_code import run_extensions


def require_names(config: Config) -> None:
    """
    Run the extensions of a configuration, and look up the loss and the formats that it names.

    Raises
    ------
    ConfigError
        One of them is not known.
    AssetError
        An extension cannot be run.
    """
    run_extensions(config.extensions)
    image_loss(config.loss.image)
    for name in config.export.formats:
        WRITERS[name]
