"""The columns of the tables: key of the figure, heading, meaning."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One figure of the table: its key in a summary, its heading, and what it says."""

    key: str
    heading: str
    meaning: str
    digits: int = 3


COLUMNS = (
    Column("shapes", "shapes", "number of shapes with a map", 0),
    Column("sigma_mean", "mean σ", "isometric distortion, mean over triangles, then over shapes"),
    Column("sigma_max", "worst σ", "largest isometric distortion of any triangle of the group"),
    Column("sigma_area", "mean σ (area)", "isometric distortion, area-weighted mean"),
    Column("conformal_mean", "mean σ^con", "conformal distortion, mean over triangles and shapes"),
    Column("conformal_max", "worst σ^con", "largest conformal distortion of any triangle"),
    Column("c", "c", "consistency c(m_i, m_j) of the paper, over 6 nearest of the measured pairs"),
    Column("c_rotated", "c (rotated)", "c rotated as error (rotated)"),
    Column(
        "c_registered",
        "c (registered)",
        "c after a rotation found from the maps alone; not fit=register",
    ),
    Column("c_area", "c (area)", "c at points area-uniform on the shape"),
    Column(
        "c_frame",
        "c (frame)",
        "c where no ground truth is, each point's own place taken for its true one; perfect maps "
        "are above 0",
    ),
    Column("c_frame_registered", "c (frame, registered)", "the same, rotated as c (registered)"),
    Column("c_frame_area", "c (frame, area)", "c (frame) at points area-uniform on the shape"),
    Column("error", "error", "implied correspondence over √area, no rotation, mean over pairs", 4),
    Column(
        "error_rotated",
        "error (rotated)",
        "the same after the rotation of each pair that makes it least",
        4,
    ),
    Column(
        "error_registered",
        "error (registered)",
        "the same after a rotation found from the maps alone; not fit=register",
        4,
    ),
    Column("geodesic", "geodesic", "the error along the surface, no rotation", 4),
    Column("geodesic_rotated", "geodesic (rotated)", "the same, rotated as error (rotated)", 4),
    Column("within", "within 0.05", "share of points whose geodesic error is at most 0.05"),
    Column(
        "error_prediction",
        "error (prediction)",
        "the same between the surfaces that the maps were read off, through closest points",
        4,
    ),
    Column(
        "keypoint_error",
        "keypoints",
        "implied correspondence over √area at semantic keypoints, no rotation",
        4,
    ),
    Column(
        "keypoint_error_symmetric",
        "keypoints (symmetric)",
        "the same, points that a symmetry of the shape exchanges in their best order",
        4,
    ),
    Column("bad_faces_percent", "bad faces %", "folded or collapsed faces on the sphere"),
    Column("affected_shapes", "affected", "shapes with a bad face or a degree other than 1", 0),
    Column("coverage_mean", "coverage", "shape to its icosphere remesh over √area, mean", 4),
    Column("coverage_max", "max coverage", "shape to its icosphere remesh over √area, max", 4),
    Column("seconds", "seconds", "run time for one shape, mean", 2),
)
TERMINAL = (
    "shapes",
    "sigma_mean",
    "sigma_max",
    "conformal_mean",
    "c",
    "c_frame",
    "c_frame_registered",
    "error",
    "error_rotated",
    "error_registered",
    "bad_faces_percent",
    "affected_shapes",
    "coverage_mean",
    "seconds",
)


@dataclass(frozen=True)
class Part:
    """One of the tables: its title and its columns."""

    title: str
    columns: tuple[Column, ...]


PARTS = (
    Part(
        "Distortion",
        (
            Column("sigma_mean", "mean σ", "isometric distortion, mean over triangles, shapes"),
            Column("sigma_max_mean", "max σ", "largest of any triangle, mean over shapes"),
            Column("sigma_max", "worst σ", "largest of any triangle of any shape"),
            Column(
                "sigma_area", "mean σ (area)", "area-weighted mean over triangles, over shapes"
            ),
            Column("conformal_mean", "mean σ^con", "conformal distortion, as mean σ"),
            Column("conformal_max", "worst σ^con", "conformal distortion, as worst σ"),
            Column("coverage_mean", "coverage", "shape to icosphere remesh over √area, mean", 4),
            Column("coverage_max", "max coverage", "the same, largest", 4),
        ),
    ),
    Part(
        "Consistency",
        (
            Column("c", "c", "consistency of the paper, over nearest of the pairs, no rotation"),
            Column("c_registered", "c (registered)", "after a rotation found without truth"),
            Column("c_rotated", "c (rotated)", "rotated as error (rotated)"),
            Column("c_area", "c (area)", "c at points area-uniform on the shape, no rotation"),
            Column("c_area_rotated", "c (area, rotated)", "rotated as error (rotated)"),
            Column("c_frame", "c (frame)", "without truth: c of each point's own place"),
            Column("c_frame_registered", "c (frame, registered)", "as c (registered)"),
            Column("c_frame_area", "c (frame, area)", "at points area-uniform on the shape"),
            Column("error", "error", "implied correspondence over √area, no rotation", 4),
            Column("error_registered", "error (registered)", "as c (registered)", 4),
            Column(
                "error_rotated",
                "error (rotated)",
                "after the rotation of each pair that makes it least",
                4,
            ),
            Column("error_median", "median error", "over pairs, no rotation", 4),
            Column("geodesic", "geodesic", "error along the surface, no rotation", 4),
            Column("geodesic_rotated", "geodesic (rotated)", "rotated as error (rotated)", 4),
            Column("within", "within 0.05", "share of points of at most that geodesic error"),
            Column("within_rotated", "within 0.05 (rotated)", "rotated as error (rotated)"),
            Column("pairs", "pairs", "pairs with dense ground truth that were measured", 0),
            Column("frame_pairs", "pairs (frame)", "pairs without truth that were measured", 0),
        ),
    ),
    Part(
        "Keypoints of shapes without common dense truth",
        (
            Column("keypoint_error", "error", "implied correspondence over √area, no rotation", 4),
            Column("keypoint_error_registered", "error (registered)", "after such a rotation", 4),
            Column("keypoint_error_rotated", "error (rotated)", "after the best of each pair", 4),
            Column("keypoint_pairs", "pairs", "pairs of shapes that were measured", 0),
        ),
    ),
    Part(
        "Bijectivity",
        (
            Column("shapes", "shapes", "shapes with a map", 0),
            Column("failures", "failures", "shapes without one, or whose map was not measured", 0),
            Column("bad_faces_percent", "bad faces %", "folded or collapsed on the sphere", 4),
            Column("affected_shapes", "affected", "shapes with a bad face or such a degree", 0),
            Column("wrong_degree", "degree ≠ ±1", "shapes of another degree than 1 or -1", 0),
        ),
    ),
    Part(
        "Run time",
        (
            Column("seconds_median", "seconds", "for one shape, by the clock, median", 2),
            Column("seconds_max", "max seconds", "the same, largest", 2),
            Column(
                "processor_seconds_median",
                "processor seconds",
                "for one shape, of all threads, median; other jobs on the machine hardly show",
                2,
            ),
            Column("processor_seconds_max", "max processor seconds", "the same, largest", 2),
            Column("vertices_median", "vertices", "of a shape, median", 0),
            Column("vertices_max", "max vertices", "of a shape, largest", 0),
        ),
    ),
)
