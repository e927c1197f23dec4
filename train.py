"""Learn consistent spherical parameterizations of a collection of genus-0 shapes.

python train.py                                    the quickstart: all stages on 30 heads
python train.py experiment=quadrupeds stage=augment    one stage
python train.py --help                             stages, groups, every setting
"""

import os
import sys

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

# Threads that wait must not keep the core from other processes: without this, two busy programs
# on two cores slow each other down tenfold. Read when torch is first imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# Hydra hands its errors on instead of printing them, so that one line tells what was mistyped.
os.environ.setdefault("HYDRA_FULL_ERROR", "1")


@hydra.main(version_base="1.3", config_path="conf", config_name="config")
def main(cfg: DictConfig) -> float | None:
    """Compose the configuration, run what it names, return the headline metric."""
    # Imported late: --help and misspelt words need none of it.
    from gensp.mistakes import one_line_errors
    from gensp.ranks import of_several
    from gensp.run import run
    from gensp.stopping import one_line_stop
    from gensp.terminal import complain

    job = HydraConfig.get()
    sweep = job.mode == RunMode.MULTIRUN
    several = of_several(cfg.trainer)
    with one_line_stop(complain, several=several), one_line_errors(sweep=sweep):
        return run(cfg, job.overrides.task, sweep=sweep)


if __name__ == "__main__":
    from gensp.mistakes import one_line_words

    with one_line_words():
        if {"-m", "--multirun"} & set(sys.argv):
            from gensp.sweeps import with_swept

            sys.argv[1:] = with_swept(sys.argv[1:])
        main()
