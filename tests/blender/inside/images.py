# SPDX-License-Identifier: GPL-3.0-or-later
"""Images made by tests."""

import bpy
import numpy as np


def packed_image(name, values, *, is_float):
    """values: (height, width, 3), row 0 at the bottom."""
    height, width = values.shape[:2]
    image = bpy.data.images.new(name, width, height, float_buffer=is_float)
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = values
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    # What is only in memory is lost to a renderer that reads the file.
    image.pack()
    return image
