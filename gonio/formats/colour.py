"""CIE XYZ and linear sRGB (IEC 61966-2-1), for formats that hold tristimulus values.

A perfect white has equal R, G and B; its XYZ is the white point D65 with Y = 1. Reflectances in such files
are per unit of Y.
"""

from __future__ import annotations

import numpy as np

RGB_TO_XYZ = np.array(
    [[0.4123908, 0.3575843, 0.1804808], [0.2126390, 0.7151687, 0.0721923], [0.0193308, 0.1191948, 0.9505322]]
)
XYZ_TO_RGB = np.linalg.inv(RGB_TO_XYZ)
