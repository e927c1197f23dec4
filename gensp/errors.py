"""What can go wrong, in one line a person can act on.

Every message says which file or shape, what was found, what is required and what to type.
"""


class GenSPError(Exception):
    """Base of every error that gensp raises on purpose.

    Attributes
    ----------
    of_all
        Whether all ranks of a run raise it together, so that one of them tells it.
    """

    of_all = False


class BadMesh(GenSPError):
    """A mesh that cannot be parameterized over the sphere."""


class UnreadableMesh(BadMesh):
    """The file is missing, empty, truncated or not a triangle mesh."""


class NotGenusZero(BadMesh):
    """Open, non-manifold, inconsistently oriented, several components, or genus above zero."""


class DegenerateMesh(BadMesh):
    """Not-a-number coordinates, zero-area or too few triangles, or more faces than allowed."""


class EmptyLevelSet(GenSPError):
    """An implicit field has no usable zero level set in the sampled box."""


class RegistrationFailed(GenSPError):
    """A non-rigid registration lost its target after every retry."""


class NotEmbeddable(GenSPError):
    """A spherical map that could not be made free of folded faces."""


class MissingStage(GenSPError):
    """A stage was asked to run before the stage that it reads."""


class StaleRun(GenSPError):
    """A run folder holds results of other settings."""


class RunInUse(GenSPError):
    """Another process works in the run folder."""


class MissingData(GenSPError):
    """A collection's folder or file is not where the configuration says."""


class DamagedFile(GenSPError):
    """A file is not what was written: cut short, changed, or of another kind."""


class TrainingDiverged(GenSPError):
    """A loss or a weight is no longer a finite number."""

    of_all = True


class RankLost(GenSPError):
    """Another rank of the run has ended, and with it what all of them do together."""

    of_all = True


class OutputError(GenSPError):
    """An output could not be written: disk full, read-only, or no permission."""


class Unsupported(GenSPError):
    """A combination of settings that cannot give a correct result."""


class ExternalToolFailed(GenSPError):
    """A program of other authors is missing, failed, or left no spherical map."""
