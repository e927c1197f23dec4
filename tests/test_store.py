from pathlib import Path

import pytest
import torch

from gensp.errors import MissingStage, Unsupported
from gensp.models import (
    AnchoredGenerator,
    DirectGenerator,
    FlowGenerator,
    ImplicitField,
    PointNet2Encoder,
    load_model,
    save_model,
)
from gensp.models.network import Network

NETWORKS = {
    "encoder": lambda: PointNet2Encoder(4, width=4, groups=((16, 4),), radii=(0.5,)),
    "field": lambda: ImplicitField(4, width=8, depth=3, inject=(2,), octaves=2),
    "direct": lambda: DirectGenerator(4, width=8, depth=2, inject=[]),
    "anchored": lambda: AnchoredGenerator(4, rank=2, width=8, depth=2),
    "flow": lambda: FlowGenerator(4, rank=2, steps=2, width=8, depth=2),
}


@pytest.mark.parametrize("name", list(NETWORKS))
def test_network_comes_back_as_it_was(name: str, tmp_path: Path) -> None:
    network = NETWORKS[name]()
    if hasattr(network, "latent_scale"):
        network.latent_scale.fill_(3.5)
    save_model(tmp_path / "model.pt", network=network)
    restored = load_model(tmp_path / "model.pt")["network"]
    assert restored.architecture() == network.architecture()
    assert not restored.training
    state = network.state_dict()
    assert restored.state_dict().keys() == state.keys()
    assert all(torch.equal(value, state[key]) for key, value in restored.state_dict().items())


def test_equal_networks_make_equal_files(tmp_path: Path) -> None:
    network = NETWORKS["field"]()
    for folder in ("a", "b"):
        save_model(tmp_path / folder / "model.pt", field=network)
    first, second = ((tmp_path / folder / "model.pt").read_bytes() for folder in ("a", "b"))
    assert first == second


def test_two_networks_in_one_file(tmp_path: Path) -> None:
    save_model(tmp_path / "model.pt", encoder=NETWORKS["encoder"](), field=NETWORKS["field"]())
    assert load_model(tmp_path / "model.pt").keys() == {"encoder", "field"}


def test_missing_file_names_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(MissingStage, match="stage=finetune"):
        load_model(tmp_path / "model.pt")


def test_pickled_code_is_refused_and_not_run(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple:
            return Path.touch, (tmp_path / "ran",)

    torch.save({"network": Trap()}, tmp_path / "model.pt")
    with pytest.raises(Unsupported, match="not plain tensors"):
        load_model(tmp_path / "model.pt")
    assert not (tmp_path / "ran").exists()


def test_foreign_class_is_refused(tmp_path: Path) -> None:
    class Foreign(Network):
        def __init__(self) -> None:
            super().__init__()
            self.settings = {}

    with pytest.raises(Unsupported, match="class Foreign"):
        save_model(tmp_path / "model.pt", network=Foreign())
    assert not (tmp_path / "model.pt").exists()
    described = {"architecture": {"class": "Foreign", "settings": {}}, "state_dict": {}}
    torch.save({"network": described}, tmp_path / "model.pt")
    with pytest.raises(Unsupported, match="class Foreign"):
        load_model(tmp_path / "model.pt")


@pytest.mark.parametrize("content", [[1, 2], {"network": torch.ones(3)}])
def test_other_content_is_refused(content: object, tmp_path: Path) -> None:
    torch.save(content, tmp_path / "model.pt")
    with pytest.raises(Unsupported, match=r"networks of gensp\.models are required"):
        load_model(tmp_path / "model.pt")


def test_weights_of_another_architecture_are_refused(tmp_path: Path) -> None:
    stored = {
        "architecture": NETWORKS["direct"]().architecture(),
        "state_dict": NETWORKS["anchored"]().state_dict(),
    }
    torch.save({"network": stored}, tmp_path / "model.pt")
    with pytest.raises(Unsupported, match="another architecture"):
        load_model(tmp_path / "model.pt")


def test_damaged_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "model.pt").write_bytes(b"nothing of use")
    with pytest.raises(Unsupported):
        load_model(tmp_path / "model.pt")
