"""An array and the HDF5 filter it is to be stored through."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import h5py
from numpy.typing import NDArray


class Filtered(NamedTuple):
    """Part of a compressed table's content that HDF5 itself packs."""

    data: NDArray
    options: Mapping[str, Any]
    """Keywords of `h5py.Group.create_dataset` that name the filter."""

    def create(self, group: h5py.Group, name: str) -> None:
        """Write it as a dataset of one chunk, with a checksum over what the filter made of it."""
        group.create_dataset(name, data=self.data, chunks=self.data.shape, fletcher32=True, **self.options)
