"""The one way up the house: methods of a model whose work is done in rooms that know models.

A user looks for `model.sample` where the model is; the sampler stands on identification, which
stands on models. So these methods look their function up when they are called, and no module of
this room depends on those above it.
"""

from importlib import import_module
from typing import Any


def above(module: str, name: str) -> Any:
    """A function of a room above, by the module's name without the package."""
    return getattr(import_module(f"deltaid.{module}"), name)
