"""The processes that share one training: this one alone, or those that torchrun started."""

import os
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import distributed, nn


@dataclass(frozen=True)
class Processes:
    """One process's place among the `world` processes that train together, and its device."""

    rank: int
    world: int
    device: torch.device

    @classmethod
    def join(cls) -> "Processes":
        """As torchrun's environment variables say: NCCL between GPUs, Gloo between CPUs."""
        world, cuda = int(os.environ.get("WORLD_SIZE", "1")), torch.cuda.is_available()
        device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0"))) if cuda else torch.device("cpu")
        if world == 1:
            return cls(0, 1, device)
        distributed.init_process_group("nccl" if cuda else "gloo")
        return cls(distributed.get_rank(), world, device)

    @property
    def first(self) -> bool:
        """Whether this process validates, writes and reports."""
        return self.rank == 0

    def averaging_gradients(self, network: nn.Module) -> nn.Module:
        """The network, wrapped so that its gradients are averaged over the processes."""
        if self.world == 1:
            return network
        devices = [self.device.index] if self.device.type == "cuda" else None
        return nn.parallel.DistributedDataParallel(network, device_ids=devices)

    def of_the_first(self, value: float) -> float:
        """The first process's value, so that all of them decide alike."""
        return self._shared(value, lambda shared: distributed.broadcast(shared, 0))

    def mean(self, value: float) -> float:
        """Mean over the processes."""
        return self._shared(value, distributed.all_reduce) / self.world

    def _shared(self, value: float, exchange: Callable[[torch.Tensor], object]) -> float:
        shared = torch.tensor(value, dtype=torch.float64, device=self.device)
        if self.world > 1:
            exchange(shared)
        return shared.item()

    def leave(self) -> None:
        """Wait for the others and end the group."""
        if self.world > 1:
            distributed.barrier()
            distributed.destroy_process_group()
