"""A model of the package as a finished stage, so that the pipeline maps a collection with it.

python benchmarks/model_run.py heads models/heads
python train.py -m experiment=benchmark stage=parameterize,evaluate method=gensp refine=certify \
    fit=none,register shapes=heads inputs.finetune=models/heads
"""

import argparse
import sys
from pathlib import Path

from gensp.errors import GenSPError, OutputError
from gensp.files import atomic_path
from gensp.pretrained import Shipped, shipped
from gensp.runs import Run, seal


def model_run(model: Shipped, folder: Path) -> Run:
    """Put the networks of a model of the package into a folder, as stage finetune leaves its own.

    Raises
    ------
    OutputError
        The folder holds other things.
    """
    if folder.exists() and any(folder.iterdir()):
        raise OutputError(f"{folder}: is not empty; a new folder is required; name another")
    with atomic_path(folder / "model.pt") as temporary:
        temporary.write_bytes(model.path.read_bytes())
    settings = {"model": model.name, "sha256": model.sha256}
    return seal(folder, stage="finetune", settings=settings, metrics={}, facts={})


def main() -> None:
    """Read the command line and write the folder."""
    models = shipped()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", choices=sorted(models))
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    try:
        model_run(models[given.model], given.folder)
    except GenSPError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
