"""What the learning stages keep per item: neighbourhoods of its cloud, its code, its tree edge."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gensp.data.batches import Drawn, Rows
from gensp.files import save_npz
from gensp.geometry.spanning_tree import ALL_PAIRS, spanning_tree
from gensp.models import Grouping, PointNet2Encoder
from gensp.stages.groupings import Groupings

_BATCH = 16


class CloudCodes:
    """The encoder on clouds known by name: every cloud's neighbourhoods are searched once.

    Parameters
    ----------
    folder
        Where the neighbourhoods are kept, see `Groupings`.
    """

    def __init__(self, encoder: PointNet2Encoder, folder: Path | None = None) -> None:
        self.encoder = encoder
        self._groupings = Groupings(encoder.settings["groups"], folder)

    def __call__(
        self, drawn: Sequence[Drawn], clouds: Float[Tensor, "b c 3"]
    ) -> Float[Tensor, "b d"]:
        """Codes of some named clouds."""
        codes: Tensor = self.encoder(clouds, self.grouping(drawn, clouds))
        return codes

    def grouping(self, drawn: Sequence[Drawn], clouds: Float[Tensor, "b c 3"]) -> Grouping:
        """The neighbourhoods of a batch, from the store where it has them."""
        for name, cloud in zip(drawn, clouds, strict=True):
            if name not in self._groupings:
                self._groupings.keep(name, self.encoder.group(cloud[None]))
        # Lightning moves networks to the CPU when a fit ends: neighbourhoods follow the clouds.
        return Grouping.cat([self._groupings.of(name) for name in drawn]).to(clouds.device)

    @torch.no_grad()
    def all(self, ids: Sequence[str], clouds: Float[Rows, "i s c 3"]) -> Float[Tensor, "i d"]:
        """Codes e(S) − e(S_0) of all items, S_0 first: means over the clouds of each."""
        device, draws = self.encoder.origin.device, clouds.shape[1]
        flat = range(len(ids) * draws)
        parts = [flat[k : k + _BATCH] for k in range(0, len(flat), _BATCH)]
        found = []
        for part in parts:
            rows, which = [k // draws for k in part], [k % draws for k in part]
            names = [(ids[row], draw) for row, draw in zip(rows, which, strict=True)]
            found.append(self(names, clouds[rows, which].to(device)))
        codes = torch.cat(found).unflatten(0, (len(ids), draws)).mean(dim=1)
        return codes - codes[:1]


class CodeTable(nn.Module):
    """The latest code of every item, and p_sync: codes interpolated between neighbours in a tree.

    The codes are part of the state, so that a resumed training draws what it would have drawn.
    """

    codes: Tensor
    parent: Tensor

    def __init__(self, ids: Sequence[str], latent: int) -> None:
        super().__init__()
        self.rows = {id: row for row, id in enumerate(ids)}
        self.register_buffer("codes", torch.full((len(ids), latent), torch.nan))
        self.register_buffer("parent", torch.full((len(ids),), -1))
        self.renewed = 0  # codes, that of S_0 apart, kept since the tree was spanned

    def of(self, ids: Sequence[str]) -> Float[Tensor, "b d"]:
        """Codes of the items."""
        return self.codes[[self.rows[id] for id in ids]]

    def update(
        self,
        ids: Sequence[str],
        codes: Float[Tensor, "b d"],
        total: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        """Keep new codes of some items.

        Parameters
        ----------
        total
            Sums over the ranks, each of which brings codes of its own; none: there is one rank.
        """
        rows = [self.rows[id] for id in ids]
        if total is None:
            self.codes[rows] = codes.detach()
            self.renewed += sum(row > 0 for row in rows)
            return
        fresh, count = torch.zeros_like(self.codes), torch.zeros_like(self.codes[:, :1])
        fresh[rows], count[rows] = codes.detach(), 1
        fresh, count = total(fresh), total(count)
        # Only S_0 comes from several ranks, and is zero on all of them.
        self.codes.copy_(torch.where(count > 0, fresh / count.clamp(min=1), self.codes))
        self.renewed += int((count[1:] > 0).sum())

    def join_neighbours(self) -> None:
        """Span a minimum tree over the items seen so far, rooted at S_0, the first item.

        Of more than `ALL_PAIRS` items a tree is kept until as many codes have been renewed as it
        would span, as in an epoch: trees then take much the same share of a step at any number.
        """
        seen = self.codes.isfinite().all(dim=1).nonzero()[:, 0]
        if len(seen) > ALL_PAIRS and self.renewed < len(seen) - 1:
            return
        tree = spanning_tree(self.codes[seen].cpu().double().numpy(), root=0)
        parent = torch.from_numpy(tree.parent).to(seen.device)
        self.parent.fill_(-1)
        self.parent[seen] = torch.where(parent < 0, parent, seen[parent])
        self.renewed = 0

    def join(self, parents: Mapping[str, str]) -> None:
        """Take the tree from elsewhere: item → parent; ancestors without a code are skipped."""
        for id, row in self.rows.items():
            above = parents.get(id)
            while above is not None and above not in self.rows:
                above = parents.get(above)
            self.parent[row] = -1 if above is None else self.rows[above]

    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "count d"]:
        """Codes z ~ p_sync on random edges of the tree."""
        children = (self.parent >= 0).nonzero()[:, 0].cpu()
        chosen = children[torch.randint(len(children), (count,), generator=generator)]
        share = torch.rand((count, 1), generator=generator).to(self.codes)
        chosen = chosen.to(self.codes.device)
        return torch.lerp(self.codes[self.parent[chosen]], self.codes[chosen], share)


def draws(seed: int, step: int) -> torch.Generator:
    """Random numbers of one training step, the same on all ranks and after an interruption."""
    state = np.random.SeedSequence([seed, step, 0]).generate_state(1, np.uint64)
    return torch.Generator().manual_seed(int(state[0]))


def save_codes(path: Path, ids: Sequence[str], codes: Float[Tensor, "i d"]) -> None:
    """Write latents.npz: ids and their codes, zero for S_0."""
    save_npz(path, ids=np.array(list(ids)), codes=codes.cpu().numpy())
