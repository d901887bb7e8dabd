"""Neural fits of measured materials (Sztrajman et al. 2021) as MERL files.

python -m tests.formats.nbrdf WEIGHTS.npz gold-metallic-paint OUT.binary
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from fitting.merl import decode
from gonio.formats import merl

if __name__ == "__main__":
    source, material, target = sys.argv[1:]
    networks = np.load(source)
    merl.write_function(lambda wi, wo: decode(networks, material, wi, wo), Path(target))
