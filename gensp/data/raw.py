"""Raw collections: meshes as somebody left them, which `stage=prepare` makes usable."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from gensp.data.validation import KEEP
from gensp.errors import Unsupported

if TYPE_CHECKING:
    from gensp.data.ground_truth import GroundTruth
    from gensp.data.keypoints import Record
    from gensp.geometry.mesh import Mesh


class RawCollection(Protocol):
    """What `stage=prepare` asks of a collection; `ShapeCollection` under on_bad=keep is one.

    Attributes
    ----------
    up
        Axis that points up in pictures.
    """

    name: str
    up: str

    @property
    def fingerprint(self) -> str:
        """Changes with any of the files."""
        ...

    def ids(self) -> list[str]:
        """Ids of all meshes, usable or not."""
        ...

    def mesh(self, id: str) -> "Mesh":
        """The mesh as it was found; raises BadMesh where it cannot be read."""
        ...

    def digest(self, id: str) -> str:
        """Changes with what `mesh`, `ground_truth` and `keypoint_record` give."""
        ...

    def columns(self, id: str) -> dict[str, str]:
        """What the manifest is to tell of the shape, see `gensp.data.folder.COLUMNS`."""
        ...

    def ground_truth(self, id: str) -> "GroundTruth | None":
        """Dense ground truth on the mesh as it was found."""
        ...

    def keypoint_record(self, id: str) -> "Record | None":
        """Keypoints in the coordinates of the mesh as it was found."""
        ...

    def unread_keypoints(self) -> dict[str, str]:
        """Ids whose keypoints cannot be read, and why."""
        ...

    def splits(self, ids: Sequence[str]) -> dict[str, str]:
        """Split of each of the shapes that turned out usable; those left out are not used."""
        ...


def require_preparing(name: str, on_bad: str, root: Any) -> None:
    """Refuse a raw collection where a checked one is needed.

    Raises
    ------
    Unsupported
        `on_bad` is not what `stage=prepare` sets.
    """
    if on_bad != KEEP:
        raise Unsupported(
            f"shapes={name}: its meshes are raw; closed genus-0 surfaces are required; run: "
            f"python train.py stage=prepare shapes={name} shapes.root={root} prepare.out=FOLDER, "
            "then use shapes=folder shapes.root=FOLDER"
        )


def require_rule(stage: str, on_bad: str | None) -> None:
    """Unchecked meshes go to stage=prepare alone, and all of them go there.

    Raises
    ------
    Unsupported
        Another rule was typed for stage=prepare, or its rule for another stage.
    """
    if (on_bad == KEEP) != (stage == "prepare"):
        raise Unsupported(
            f"shapes.on_bad={on_bad}: was found with stage={stage}; stage=prepare sets {KEEP}, "
            "other stages need error or skip; leave it out"
        )


def require_apart(out: str | None, root: str | None) -> None:
    """The folder that stage=prepare writes, and may clear, and that of its raw meshes are apart.

    Raises
    ------
    Unsupported
        One holds the other.
    """
    if out is None or root is None:
        return
    place, raw = Path(out).resolve(), Path(root).resolve()
    if place == raw or place in raw.parents:
        raise Unsupported(
            f"prepare.out={out}: holds shapes.root={root}; a folder of its own is required, "
            "because it may be cleared; name one that does not exist yet"
        )
    if raw in place.parents:
        raise Unsupported(
            f"prepare.out={out}: is within shapes.root={root}; a folder beside it is required, "
            "because what is written would be read as raw meshes the next time; name another one"
        )
