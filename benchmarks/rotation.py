"""Registration of spherical maps by rotation: once per map, once per pair, and its precision.

python benchmarks/rotation.py
"""

import time
from collections.abc import Callable

from cmcf import bumpy
from regularizer import row
from scipy.spatial.transform import Rotation

from gensp.geometry.rotation_registration import density_signal, register_rotation
from gensp.geometry.sphere import icosphere

LEVEL = 5  # 10,242 vertices


def least(call: Callable[[], object], repeats: int = 5) -> float:
    """Least processor seconds, after one call that fills the tables."""
    call()
    taken = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        taken.append(time.process_time() - start)
    return min(taken)


def measure() -> list[dict[str, object]]:
    """Seconds per map and per pair, and the error on a map and its turned copy."""
    mesh, sphere = bumpy(LEVEL), icosphere(LEVEL).vertices
    turn = Rotation.from_rotvec([1.2, -2.0, 0.7]).as_matrix()
    a, b = (density_signal(x, mesh.faces, mesh.face_areas) for x in (sphere, sphere @ turn.T))
    found = register_rotation(a, b)[0].rotation
    angle = Rotation.from_matrix(found @ turn.T).magnitude()
    once = least(lambda: density_signal(sphere, mesh.faces, mesh.face_areas))
    pair = least(lambda: register_rotation(a, b, candidates=1))
    return [
        row(f"rotation: signal of a map, {len(sphere)} vertices", once, "s"),
        row("rotation: registration of a pair", pair, "s", "≤ 0.1"),
        row("rotation: error on a turned map", float(angle), "rad", "≤ 1e-6"),
    ]


if __name__ == "__main__":
    for line in measure():
        print("{name:60s} {figure:8.3g} {unit:2s} {required}".format(**line))  # noqa: T201
