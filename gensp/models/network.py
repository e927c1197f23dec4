"""What every network of the library shares: it knows how it was built."""

from typing import Any

from torch import nn


class Network(nn.Module):
    """A module that keeps its constructor's arguments, so that plain data can rebuild it.

    Subclasses set `settings` to the arguments of their constructor: numbers, texts and lists of
    them. `gensp.models.store` writes and reads these descriptions.
    """

    settings: dict[str, Any]

    def architecture(self) -> dict[str, Any]:
        """Class name and settings."""
        return {"class": type(self).__name__, "settings": dict(self.settings)}
