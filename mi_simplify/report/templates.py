"""
Pages are Jinja2 templates in the folder ``web`` beside this module; whatever is put into one is escaped.
"""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup


def render(template: str, **values: Any) -> Markup:
    """
    Fill a template of the folder ``web``.

    Parameters
    ----------
    template : str
        Its file name.
    values
        What it shows: text, which is escaped, numbers, :class:`markupsafe.Markup`, and lists and mappings of these.

    Returns
    -------
    Markup
        So that another template takes it as it is.

    Raises
    ------
    jinja2.UndefinedError
        The template asks for a value that is missing, a defect of ours.
    """
    return Markup(_environment().get_template(template).render(values))


def web_file(name: str) -> str:
    """
    A template, script or style sheet of the folder ``web``.
    """
    return files(__package__).joinpath("web", name).read_text(encoding="utf-8")


def script_hash(text: str) -> str:
    """
    What a Content-Security-Policy calls the one script that it lets run.
    """
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@cache
def _environment() -> Environment:
    """Escaping is always on; JSON is compact, keeps its order, and refuses NaN, which no browser reads."""
    environment = Environment(
        loader=FunctionLoader(web_file),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment
