"""Networks in files: a description and tensors, never pickled code."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from gensp.errors import DamagedFile, MissingStage, Unsupported
from gensp.files import atomic_path, require_whole_archive
from gensp.models.atlas import Atlas
from gensp.models.encoder import PointNet2Encoder
from gensp.models.generator import AnchoredGenerator, DirectGenerator, FlowGenerator
from gensp.models.implicit import ImplicitField
from gensp.models.network import Network

CLASSES: dict[str, type[Network]] = {
    cls.__name__: cls
    for cls in (
        PointNet2Encoder,
        ImplicitField,
        DirectGenerator,
        AnchoredGenerator,
        FlowGenerator,
        Atlas,
    )
}


def save_model(path: Path | str, **networks: Network) -> None:
    """Write networks by name, whole or not at all.

    Raises
    ------
    Unsupported
        A network is not of a class of `gensp.models`.
    """
    content = {}
    for name, network in networks.items():
        _known_class(type(network).__name__, Path(path))
        state = {key: value.cpu() for key, value in network.state_dict().items()}
        content[name] = {"architecture": network.architecture(), "state_dict": state}
    # In memory first: the format keeps the file's name, and equal networks make equal files.
    data = io.BytesIO()
    torch.save(content, data)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data.getbuffer())


def load_model(path: Path | str) -> dict[str, Network]:
    """Read the networks of a file, by name, on the CPU and in evaluation mode.

    Raises
    ------
    MissingStage
        There is no such file.
    Unsupported
        The file is no model of gensp: other content, foreign classes or pickled code.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingStage(
            f"{path}: does not exist; a trained model.pt is required; "
            "run python train.py stage=finetune"
        )
    try:
        require_whole_archive(path)  # torch itself compares no checksums
        content = torch.load(path, map_location="cpu", weights_only=True)
    except DamagedFile as error:
        raise Unsupported(f"{error}; or write it anew with stage=finetune") from error
    # Unpicklers raise whatever they meet; the file is at fault in each case.
    except Exception as error:
        raise Unsupported(_foreign(path, "not plain tensors and numbers")) from error
    if not isinstance(content, Mapping):
        raise Unsupported(_foreign(path, f"a {type(content).__name__}"))
    return {name: _restored(stored, path) for name, stored in content.items()}


def _restored(stored: Any, path: Path) -> Network:
    if not isinstance(stored, Mapping) or {"architecture", "state_dict"} - stored.keys():
        raise Unsupported(_foreign(path, "no architecture and state_dict"))
    architecture, state = stored["architecture"], stored["state_dict"]
    if not isinstance(architecture, Mapping) or {"class", "settings"} - architecture.keys():
        raise Unsupported(_foreign(path, "no class and settings"))
    make = _known_class(architecture["class"], path)
    try:
        _require_modest(architecture["settings"], sum(value.numel() for value in state.values()))
        network = make(**architecture["settings"])
        network.load_state_dict(state)
    # Whatever a constructor says of foreign settings, or torch of foreign weights.
    except Exception as error:
        raise Unsupported(_foreign(path, "weights of another architecture")) from error
    return network.eval()


def _require_modest(settings: Any, numbers: int) -> None:
    """Refuse sizes beyond the weights that are there, before memory is taken for them."""
    if isinstance(settings, Mapping | list | tuple):
        for value in settings.values() if isinstance(settings, Mapping) else settings:
            _require_modest(value, numbers)
    elif isinstance(settings, int) and settings > numbers:
        raise ValueError(f"a size of {settings} for {numbers} numbers")


def _known_class(name: Any, path: Path) -> type[Network]:
    if not isinstance(name, str) or name not in CLASSES:
        raise Unsupported(_foreign(path, f"a network of class {name}"))
    return CLASSES[name]


def _foreign(path: Path, found: str) -> str:
    return (
        f"{path}: holds {found}; networks of gensp.models are required "
        f"({', '.join(CLASSES)}); write it with stage=implicit, initialize or finetune"
    )
