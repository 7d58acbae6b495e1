"""Parallel work on many machines: joblib's Dask backend, around any sweep or data set."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import joblib

from warp_peri.errors import InputError, optional

WAIT = 30
"""Seconds that a scheduler and its first worker are waited for."""


@contextmanager
def scheduler(address: str | None) -> Iterator[None]:
    """Run joblib's work inside on the workers of a Dask scheduler; here where address is None.

    Workers that die are replaced; they must see the same files and have this library installed.

    Args:
        address: of the scheduler, such as tcp://host:8786.

    Raises InputError when Dask is not installed, or no scheduler with a worker answers.
    """
    if address is None:
        yield
        return
    distributed = optional("distributed", "scheduler: needs Dask: pip install 'warp_peri[cluster]'")
    try:
        client = distributed.Client(address, timeout=WAIT)
        client.wait_for_workers(1, timeout=WAIT)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"scheduler: no workers at {address} ({error})") from None
    with client, joblib.parallel_config(backend="dask"):
        yield
