"""A generated family of limbed blobs: one skinned template in many poses, each remeshed.

The template is the smooth union of tapered capsules. Every sample poses the same template, so its
ground truth is exact up to remeshing, and has a triangulation of its own.
"""

import csv
import io
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import igl.predicates
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp, softmax
from skimage.measure import marching_cubes

from gensp.data.ground_truth import GroundTruth, save_ground_truth
from gensp.errors import BadMesh, Unsupported
from gensp.files import content_hash, write_text
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh, normalize, require_genus_zero, save_mesh, simplify

# Counted up when the recipe below changes, so that kept families are made anew.
_VERSION = 2
# Sharpness of the smooth union and of the skin weights, per unit length.
_UNION, _SKIN = 18.0, 14.4
_CELLS = 72
_ATTEMPTS_PER_SHAPE = 30
_TRUTH_POINTS = 1024
_Triple = tuple[float, float, float]


@dataclass(frozen=True)
class BlobFamily:
    """What determines the family; the same numbers give the same files.

    Attributes
    ----------
    leg_radius, leg_length
        The difficulty: thin long legs are what spherical parameterizations starve.
    amplitude
        Scale of the random joint angles and bone lengths.
    test
        How many of the shapes are held out.
    """

    count: int = 6
    vertices: int = 600
    test: int = 2
    seed: int = 0
    leg_radius: float = 0.18
    leg_length: float = 1.0
    amplitude: float = 0.5
    noise: float = 2e-3


@dataclass(frozen=True)
class _Skeleton:
    """b bones: start and end joints (b, 3), radii there (b, 2), parents (root -1)."""

    start: Float[np.ndarray, "b 3"]
    end: Float[np.ndarray, "b 3"]
    radius: Float[np.ndarray, "b 2"]
    parent: tuple[int, ...]


def _skeleton(leg_radius: float, leg_length: float) -> _Skeleton:
    """A body along x with neck, head, two tail bones and four legs of two bones, y up."""
    bones: list[tuple[_Triple, _Triple, tuple[float, float], int]] = [
        ((-0.7, 0, 0), (0.7, 0, 0), (0.42, 0.42), -1),
        ((0.7, 0.15, 0), (1.05, 0.55, 0), (0.28, 0.24), 0),
        ((1.05, 0.55, 0), (1.45, 0.6, 0), (0.3, 0.22), 1),
        ((-0.9, 0.15, 0), (-1.35, 0.3, 0), (0.2, 0.17), 0),
        ((-1.35, 0.3, 0), (-1.75, 0.25, 0), (0.17, 0.14), 3),
    ]
    for x in (-0.65, 0.65):
        for z in (-0.28, 0.28):
            hip, knee = (x, -0.15, z), (x, -0.15 - 0.52 * leg_length, 1.15 * z)
            foot = (x + 0.05, -0.15 - leg_length, 1.2 * z)
            bones.append((hip, knee, (1.2 * leg_radius, leg_radius), 0))
            bones.append((knee, foot, (leg_radius, 0.85 * leg_radius), len(bones) - 1))
    start, end, radius, parent = zip(*bones, strict=True)
    return _Skeleton(np.array(start), np.array(end), np.array(radius), parent)


def _bone_distances(
    points: Float[np.ndarray, "n 3"], bones: _Skeleton
) -> Float[np.ndarray, "n b"]:
    """Distance of points to every tapered capsule, negative inside."""
    axis = bones.end - bones.start
    offset = points[:, None] - bones.start
    t = np.clip(np.einsum("nbj,bj->nb", offset, axis) / np.sum(axis**2, axis=1), 0, 1)
    radius = bones.radius[:, 0] * (1 - t) + bones.radius[:, 1] * t
    return np.linalg.norm(offset - t[..., None] * axis, axis=2) - radius


@lru_cache(maxsize=2)
def _template(leg_radius: float, leg_length: float, vertices: int) -> Mesh:
    """The rest shape: zero level of the smooth union of the bones."""
    bones = _skeleton(leg_radius, leg_length)
    joints = np.concatenate([bones.start, bones.end])
    low, high = joints.min(axis=0) - 0.6, joints.max(axis=0) + 0.6
    cell = (high - low).max() / _CELLS
    axes = [np.arange(low[k], high[k] + cell, cell) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    distance = -logsumexp(-_UNION * _bone_distances(grid.reshape(-1, 3), bones), axis=1) / _UNION
    corners, faces, *_ = marching_cubes(  # type: ignore[no-untyped-call]
        distance.reshape(grid.shape[:3]), 0.0, spacing=(cell,) * 3, gradient_direction="descent"
    )
    surface = Mesh(corners.astype(np.float64) + low, faces.astype(np.int64), "template")
    template = simplify(surface, vertices)
    require_genus_zero(template)
    return template


def _pose(
    template: Mesh, bones: _Skeleton, amplitude: float, generator: np.random.Generator
) -> Mesh:
    """Bend and stretch the bones at random; parents carry children (linear blend skinning)."""
    weights = softmax(-_SKIN * _bone_distances(template.vertices, bones), axis=1)
    linear, shift = _bone_motions(bones, amplitude, generator)
    moved = np.einsum("bij,nj->nbi", linear, template.vertices) + shift
    return template.with_vertices(np.einsum("nb,nbi->ni", weights, moved), "posed")


def _bone_motions(
    bones: _Skeleton, amplitude: float, generator: np.random.Generator
) -> tuple[Float[np.ndarray, "b 3 3"], Float[np.ndarray, "b 3"]]:
    """Affine motion x → A x + s of every bone: stretch along it, thicken, rotate at its start."""
    count = len(bones.parent)
    angles = amplitude * 0.45 * generator.standard_normal((count, 3))
    # The body stays where it is: collections are roughly aligned.
    angles[0] = 0
    turns = Rotation.from_rotvec(angles).as_matrix()
    length, thickness = np.exp(amplitude * generator.normal(scale=(0.2, 0.12), size=(count, 2))).T
    turned = np.zeros((count, 3, 3))
    linear, shift = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for bone, parent in enumerate(bones.parent):
        axis = bones.end[bone] - bones.start[bone]
        along = np.outer(axis, axis) / (axis @ axis)
        stretch = thickness[bone] * (np.eye(3) - along) + length[bone] * along
        root = parent < 0
        turned[bone] = turns[bone] if root else turned[parent] @ turns[bone]
        joint = bones.start[bone]
        carried = joint if root else linear[parent] @ joint + shift[parent]
        linear[bone] = turned[bone] @ stretch
        shift[bone] = carried - linear[bone] @ joint
    return linear, shift


def _remesh(posed: Mesh, vertices: int, noise: float, generator: np.random.Generator) -> Mesh:
    """A triangulation of its own: noise, decimation, projection back to the posed template."""
    shaken = posed.vertices + noise * generator.standard_normal(posed.vertices.shape)
    count = int(vertices * generator.uniform(0.92, 1.08))
    coarse = simplify(posed.with_vertices(shaken), count)
    return coarse.with_vertices(closest_point(coarse.vertices, posed).points)


def _self_intersects(mesh: Mesh) -> bool:
    found, *_ = igl.predicates.find_self_intersections(mesh.vertices, mesh.faces, True)
    return bool(np.asarray(found).any())


def blob_samples(family: BlobFamily) -> Iterator[tuple[Mesh, GroundTruth]]:
    """Posed, remeshed, embedded genus-0 samples with ground truth, all at area 4π.

    Raises
    ------
    Unsupported
        Too many poses intersect themselves.
    """
    generator = np.random.default_rng(family.seed)
    bones = _skeleton(family.leg_radius, family.leg_length)
    template = _template(family.leg_radius, family.leg_length, 3 * family.vertices)
    chosen = np.sort(generator.permutation(len(template.vertices))[:_TRUTH_POINTS])
    made = 0
    for _ in range(_ATTEMPTS_PER_SHAPE * family.count):
        if made == family.count:
            return
        posed = normalize(_pose(template, bones, family.amplitude, generator))
        try:
            mesh = _remesh(posed, family.vertices, family.noise, generator)
            require_genus_zero(mesh)
        except BadMesh:
            continue
        if _self_intersects(posed) or _self_intersects(mesh):
            continue
        at = closest_point(posed.vertices[chosen], mesh).at
        yield mesh, GroundTruth("blob", chosen, at)
        made += 1
    if made < family.count:
        raise Unsupported(
            f"blobs: {made} of {family.count} poses are free of self-intersection; shorter or "
            "thicker limbs are required; lower shapes.amplitude"
        )


def generate_blobs(cache: Path | str, family: BlobFamily) -> Path:
    """Folder of the family's meshes, ground truth and manifest, made once per settings."""
    root = Path(cache) / f"blobs-{content_hash(asdict(family), _VERSION)}"
    if (root / "manifest.csv").is_file():
        return root
    rows = []
    for index, (mesh, truth) in enumerate(blob_samples(family)):
        name = f"blob{index:02d}"
        save_mesh(mesh, root / "meshes" / f"{name}.ply")
        save_ground_truth(root / "corr" / f"{name}.npz", truth)
        split = "test" if index >= family.count - family.test else "train"
        rows.append([f"meshes/{name}.ply", "blob", split, f"corr/{name}.npz"])
    text = io.StringIO()
    csv.writer(text).writerows([["file", "category", "split", "correspondence"], *rows])
    write_text(root / "manifest.csv", text.getvalue())
    return root
