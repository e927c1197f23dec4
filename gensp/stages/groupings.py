"""Neighbourhoods of clouds, kept on disk while a stage trains."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
import torch

from gensp.data.batches import Drawn
from gensp.errors import OutputError
from gensp.models import Grouping


class Groupings:
    """Groupings of named clouds in a file without a name, which is gone with the process.

    Parameters
    ----------
    groups
        Centres and neighbours per centre of every level of the encoder.
    folder
        On which disk the file is; without, where the system keeps such files.
    """

    def __init__(self, groups: Sequence[Sequence[int]], folder: Path | None = None) -> None:
        self.groups = [tuple(level) for level in groups]
        self.folder = folder
        self._rows: dict[Drawn, int] = {}
        self._file: BinaryIO | None = None
        self._bytes = 4 * sum(centres * (1 + size) for centres, size in self.groups)

    def __contains__(self, name: Drawn) -> bool:
        return name in self._rows

    def keep(self, name: Drawn, grouping: Grouping) -> None:
        """Keep the grouping of one cloud.

        Raises
        ------
        OutputError
            The disk is full or read-only, or the folder may not be written.
        """
        levels = zip(grouping.centres, grouping.neighbours, strict=True)
        flat = torch.cat([part.flatten() for level in levels for part in level])
        row = len(self._rows)
        self._write(row, flat.to("cpu", torch.int32).numpy().tobytes())
        self._rows[name] = row

    def _write(self, row: int, data: bytes) -> None:
        try:
            if self._file is None:
                if self.folder is not None:
                    self.folder.mkdir(parents=True, exist_ok=True)
                self._file = tempfile.TemporaryFile(dir=self.folder, buffering=0)  # noqa: SIM115
            done = 0
            while done < len(data):  # after a part the system tells why there is no more
                done += os.pwrite(self._file.fileno(), data[done:], row * self._bytes + done)
        except OSError as error:
            raise OutputError(
                f"{self.folder or tempfile.gettempdir()}: cannot be written "
                f"({error.strerror or error}); room for the neighbourhoods of all clouds, "
                f"{self._bytes} bytes each, is required; name another folder with "
                "paths.runs=FOLDER"
            ) from error

    def of(self, name: Drawn) -> Grouping:
        """The grouping of one cloud that was kept."""
        if self._file is None:
            raise KeyError(name)
        data = os.pread(self._file.fileno(), self._bytes, self._rows[name] * self._bytes)
        flat = torch.from_numpy(np.frombuffer(data, dtype=np.int32).astype(np.int64))
        centres, neighbours = [], []
        for count, size in self.groups:
            here, around, flat = flat.split([count, count * size, len(flat) - count * (1 + size)])
            centres.append(here[None])
            neighbours.append(around.reshape(1, count, size))
        return Grouping(tuple(centres), tuple(neighbours))
