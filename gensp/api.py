"""Arrays in, arrays out: what `import gensp` offers for one mesh."""

from collections.abc import Collection
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from gensp.errors import DegenerateMesh, MissingStage, Unsupported
from gensp.geometry.certificate import require_bijective
from gensp.geometry.mesh import FORMATS, Mesh, require_genus_zero
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods import SphericalParameterization
from gensp.methods.table import DEFAULT, per_shape

if TYPE_CHECKING:
    from gensp.methods.gensp import GenSP


def parameterize(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    method: str | SphericalParameterization = DEFAULT,
) -> Float[np.ndarray, "n 3"]:
    """Unit sphere positions of a closed genus-0 mesh's vertices, in their order.

    Parameters
    ----------
    vertices, faces
        Positions (n, 3) and triangles (m, 3), counter-clockwise seen from outside.
    method
        A name of `gensp.methods.table`, or a method such as `gensp.load` returns.

    Returns
    -------
    Float[np.ndarray, "n 3"]
        The bijective map, certified with degree 1; `gensp.spherical_map` gives it with all that
        belongs to it.

    Raises
    ------
    BadMesh
        Not a closed, oriented, connected genus-0 mesh.
    NotEmbeddable
        The map has folds, as those of methods that repair none (arap, vc25, cmcf_raw) may have, or
        it mirrors. `gensp.spherical_map` hands them out.
    Unsupported
        No method has this name.
    """
    map = spherical_map(vertices, faces, method=method)
    remedy = f"use method='{DEFAULT}', or look at the map with gensp.spherical_map"
    require_bijective(map.mesh, map.sphere, remedy=remedy)
    return map.sphere


def spherical_map(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    method: str | SphericalParameterization = DEFAULT,
    name: str = "mesh",
) -> SphericalMap:
    """The same as a `SphericalMap`: certificate, distortion, point location, remeshes.

    Parameters are those of `parameterize`; `name` stands in messages and file names. The map is
    handed out as the method leaves it: those of arap, vc25 and cmcf_raw may have folds, and
    `SphericalMap.certify` tells. All others raise `NotEmbeddable` rather than give a fold.
    """
    mesh = as_mesh(vertices, faces, name)
    require_genus_zero(mesh)
    return (per_shape(method) if isinstance(method, str) else method)(mesh)


def as_mesh(vertices: ArrayLike, faces: ArrayLike, name: str = "mesh") -> Mesh:
    """Arrays as a mesh in float64 and int64.

    Raises
    ------
    DegenerateMesh
        Other shapes than (n, 3) and (m, 3), or faces that are not whole numbers.
    """
    positions, triangles = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    whole = np.issubdtype(triangles.dtype, np.integer)
    flat = [x.ndim != 2 or x.shape[1] != 3 or len(x) == 0 for x in (positions, triangles)]
    if any(flat) or not whole:
        remedy = "reshape them" if any(flat) else "cast them: faces.astype(int)"
        raise DegenerateMesh(
            f"{name}: vertices {positions.shape} and faces {triangles.shape} of "
            f"{triangles.dtype}; (n, 3) numbers and (m, 3) integers are required; {remedy}"
        )
    return Mesh(np.ascontiguousarray(positions), np.array(triangles, dtype=np.int64), name)


def load(model: Path | str, *, register: bool | None = None, **settings: Any) -> "GenSP":
    """The GenSP method with the networks of a model, to be called with a mesh.

    Parameters
    ----------
    model
        A model of the package ("heads", "quadrupeds", "humans"), used as it was meant to be, or
        the model.pt of stage finetune (or initialize).
    register
        Register the generated surface to the shape before the map is read off it, or do not; left
        out: as the model of the package asks for, and not for others.
    settings
        Further arguments of `gensp.GenSP`, such as level, draws or refine.

    Raises
    ------
    MissingStage
        There is no such file.
    Unsupported
        The file is no model of gensp.
    """
    from gensp.pretrained import shipped

    models = shipped()
    known = models.get(str(model))
    if known is None:
        _require_model_file(Path(model), models)
    from gensp.methods.fitting import NoFit, RegisterFit
    from gensp.methods.gensp import GenSP
    from gensp.methods.refinement import CertifiedRefinement

    chosen = (
        {"fit": NoFit(), "refine": CertifiedRefinement()} if known is None else known.settings()
    )
    if register is not None and not (register and isinstance(chosen["fit"], RegisterFit)):
        chosen["fit"] = RegisterFit() if register else NoFit()
    return GenSP.load(model if known is None else known.path, **{**chosen, **settings})


def _require_model_file(path: Path, names: Collection[str]) -> None:
    """A wrong name is told before torch is loaded, which takes seconds."""
    required = f"a trained model.pt or a model of the package ({', '.join(sorted(names))})"
    near = get_close_matches(str(path), names, n=1)
    remedy = f"did you mean {near[0]}?" if near else "run python train.py stage=finetune"
    if not path.is_file():
        raise MissingStage(f"{path}: does not exist; {required} is required; {remedy}")
    if path.suffix.lower() in (*FORMATS, ".npz"):
        raise Unsupported(f"{path}: is a mesh or a map; {required} is required; {remedy}")
