"""Processor seconds and floating point operations of the optimiser steps of a training."""

import time
from dataclasses import dataclass
from typing import Any

from lightning import Callback, LightningModule, Trainer
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry


@dataclass(frozen=True)
class Cost:
    """Processor seconds, and floating point operations as torch counts them."""

    seconds: float = 0.0
    flops: float = 0.0

    def __add__(self, other: "Cost") -> "Cost":
        return Cost(self.seconds + other.seconds, self.flops + other.flops)

    def __sub__(self, other: "Cost") -> "Cost":
        return self + -1 * other

    def __rmul__(self, factor: float) -> "Cost":
        return Cost(factor * self.seconds, factor * self.flops)


class Operations(TorchDispatchMode):
    """Counts as torch's FlopCounterMode does, without its hooks, which a no-grad call upsets."""

    def __init__(self) -> None:
        super().__init__()
        self.total = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Carry it out, and add what it takes."""
        kwargs = kwargs or {}
        found = func(*args, **kwargs)
        if func._overloadpacket in flop_registry:
            self.total += flop_registry[func._overloadpacket](*args, **kwargs, out_val=found)
        return found


class Meter(Callback):
    """The first step fills what is kept, the second is counted, the others are timed."""

    def __init__(self, *, counting: bool) -> None:
        self.counting = counting
        self.seconds: list[float] = []
        self.flops = 0.0
        self._counter: Operations | None = None
        self._began = 0.0

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """A step begins."""
        if self.counting and trainer.global_step == 1:
            self._counter = Operations()
            self._counter.__enter__()
        self._began = time.process_time()

    def on_train_batch_end(self, *_: Any) -> None:
        """A step ends."""
        if self._counter is None:
            self.seconds.append(time.process_time() - self._began)
            return
        self._counter.__exit__(None, None, None)
        self.flops, self._counter = float(self._counter.total), None
