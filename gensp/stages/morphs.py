"""The generator's surfaces on the ways from the sphere to shapes, for the pictures."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from gensp.data.shapes import SPHERE
from gensp.files import load_npz, read_json
from gensp.geometry.mesh import Mesh
from gensp.geometry.spanning_tree import along_path
from gensp.geometry.sphere import icosphere
from gensp.pictures.draw import tree_edges
from gensp.pictures.sheets import Way

_LEVEL = 5


@torch.no_grad()
def images(
    generator: torch.nn.Module, codes: Float[np.ndarray, "c d"], level: int = _LEVEL
) -> list[Mesh]:
    """Images of the icosphere under g(z, ·) for some codes z."""
    ball = icosphere(level)
    p = torch.from_numpy(ball.vertices.astype(np.float32))[None]
    z = torch.from_numpy(np.asarray(codes, dtype=np.float32))
    found = [generator(code[None], p)[0].double().numpy() for code in z]
    return [Mesh(image, ball.faces, "generated") for image in found]


def straight(
    generator: torch.nn.Module, code: Float[np.ndarray, " d"], frames: int, level: int = _LEVEL
) -> list[Mesh]:
    """Images under g(t·z, ·) for t from 0 to 1."""
    return images(generator, np.linspace(0, 1, frames)[:, None] * code, level)


@dataclass(frozen=True)
class LatentTree:
    """The tree that correspondences were carried along, at the codes of a finished model.

    Attributes
    ----------
    parents
        Parent of every node but S_0.
    codes
        Codes of the nodes that the model was trained on, zero for S_0.
    """

    parents: Mapping[str, str]
    codes: Mapping[str, Float[np.ndarray, " d"]]

    @classmethod
    def read(cls, correspond: Path, finetune: Path) -> "LatentTree":
        """From tree.json of stage correspond and latents.npz of stage finetune."""
        parents, _ = tree_edges(read_json(correspond / "tree.json"))
        stored = load_npz(finetune / "latents.npz")
        codes = stored["codes"].astype(np.float64)
        return cls(parents, dict(zip(map(str, stored["ids"]), codes, strict=True)))

    def path(self, id: str, code: Float[np.ndarray, " d"]) -> list[str]:
        """Nodes from S_0 to a shape; one that is no node hangs from the node nearest to it."""
        if id not in self.parents:
            return [*self.path(self._nearest(code), code), id]
        above = [id]
        while above[-1] in self.parents:
            above.append(self.parents[above[-1]])
        return above[::-1]

    def _nearest(self, code: Float[np.ndarray, " d"]) -> str:
        nodes = [id for id in self.codes if id in self.parents]
        gaps = np.linalg.norm(np.stack([self.codes[id] for id in nodes]) - code, axis=1)
        return nodes[int(gaps.argmin())]

    def way(
        self,
        generator: torch.nn.Module,
        id: str,
        code: Float[np.ndarray, " d"],
        frames: int,
        level: int = _LEVEL,
    ) -> Way:
        """Images at codes of equal distances along the path; ancestors without one are skipped."""
        known = {**self.codes, SPHERE: np.zeros(len(code)), id: code}
        path = [node for node in self.path(id, code) if node in known]
        codes, ends = along_path(np.stack([known[node] for node in path]), frames)
        return Way(images(generator, codes, level), [path[end] for end in ends])
