"""Making the shards of a data set on a Dask cluster; dask and distributed are imported only for
that.
"""

import asyncio
import logging
import zlib
from collections.abc import Sequence
from types import ModuleType

from nnpp_edge import __version__
from nnpp_edge.runtime.errors import NnppEdgeError, optional_module
from nnpp_edge.runtime.reading import refused_as
from nnpp_edge.terrain.dataset import Shards
from nnpp_edge.terrain.shards import Recipe, Tiles, shard_content

WORKER_WAIT_S = 60.0
"""How long to wait for the cluster's first worker."""


class ClusterError(NnppEdgeError, ConnectionError):
    """A Dask cluster that cannot be reached, or whose workers cannot make a data set."""


def shards_on_cluster(
    address: str,
    recipe: Recipe,
    tiles: Tiles,
    indices: Sequence[int],
) -> Shards:
    """Make shards on the workers of a Dask cluster, and bring them here: numbers and contents, in
    the order done.

    The `address` is the scheduler's, such as ``tcp://10.0.0.5:8786``; TLS and timeouts are as
    Dask's configuration says. The workers need no file system shared with this machine. Raises
    ClusterError, MissingExtraError, and DataSetError as for shards made here.

    Notes
    -----
    The elevation arrays are an argument of one task, on which all shards depend: they leave
    this machine once, and are handed out again where all workers who had them died (scattered data
    would be lost).
    """
    if not indices:
        return
    distributed = optional_module("distributed", "a Dask cluster", "cluster")
    dask = optional_module("dask", "a Dask cluster", "cluster")
    wanted = f"wanted a Dask scheduler with workers at {address!r}"
    # it logs at length what is raised too
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    with refused_as(ClusterError, wanted):
        asyncio.run(_try(address, distributed))
        with (
            dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}),
            distributed.Client(address, set_as_default=False) as client,
        ):
            terrain = client.submit(lambda received: received, tiles, pure=False)
            jobs = {}
            for index in indices:
                job = client.submit(_make, __version__, recipe, terrain, index, pure=False)
                jobs[job] = index
            try:
                client.wait_for_workers(1, timeout=WORKER_WAIT_S)
            except TimeoutError as error:
                raise ClusterError(
                    f"{wanted}, got none within {WORKER_WAIT_S:g} s (one that lacks nnpp-edge "
                    "leaves at once, as its log says)"
                ) from error
            for job in distributed.as_completed(list(jobs), loop=client.loop):
                content = zlib.decompress(job.result())
                yield jobs.pop(job), content


def _make(version: str, recipe: Recipe, tiles: Tiles, index: int) -> bytes:
    """One shard's file, compressed; refused on a worker of another version, which might draw other
    samples.
    """
    if version != __version__:
        raise ClusterError(f"wanted workers with nnpp-edge {version}, got one with {__version__}")
    return zlib.compress(shard_content(recipe, tiles, index), 1)


async def _try(address: str, distributed: ModuleType) -> None:
    """Connect, and hang up: a `Client` that cannot connect may, collected as garbage, wait for
    another's lock.
    """
    comm = await distributed.comm.connect(address)
    await comm.close()
