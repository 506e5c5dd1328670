"""
What a run does: the schema with all defaults, the presets, and the YAML around them.
"""

from .documentation import json_schema as json_schema
from .documentation import markdown as markdown
from .initial import InitialSettings as InitialSettings
from .layers import SAMPLE_PREFIX as SAMPLE_PREFIX
from .layers import dump as dump
from .layers import load_config as load_config
from .presets import PRESETS as PRESETS
from .problems import validated as validated
from .quantities import with_fixed as with_fixed
from .schema import Config as Config
from .schema import FitSettings as FitSettings
from .section import code_of as code_of

__all__ = [
    "PRESETS", "SAMPLE_PREFIX", "Config", "FitSettings", "InitialSettings", "code_of", "dump", "json_schema",
    "load_config", "markdown", "validated", "with_fixed",
]  # fmt: skip
