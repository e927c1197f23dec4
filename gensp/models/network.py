"""What every network of the library shares: it knows how it was built."""

from typing import Any

from torch import nn


class Network(nn.Module):
    """A module that keeps its constructor's arguments, so that plain data can rebuild it.

    Subclasses set `settings` to the keyword arguments of their constructor; a value may be
    another network. `gensp.models.store` writes and reads these descriptions.
    """

    settings: dict[str, Any]

    def architecture(self) -> dict[str, Any]:
        """Class name and settings, nested networks described in the same way."""
        settings = {
            name: value.architecture() if isinstance(value, Network) else value
            for name, value in self.settings.items()
        }
        return {"class": type(self).__name__, "settings": settings}
