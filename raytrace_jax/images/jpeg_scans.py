"""Whether a JPEG holds all of its picture: libraries fill what a progressive one lacks from what is there."""

import re

import numpy as np

MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]", re.DOTALL)
"""A marker that is followed by a length, or the end; others stand amid the picture's bits."""

END, SCAN, NO_FRAMES = 0xD9, 0xDA, (0xC4, 0xC8, 0xCC)


def lacks_scans(data: bytes) -> bool:
    """Whether a JPEG's file ends before all bits of all coefficients have come (ISO/IEC 10918-1, B.2 and G.1.1)."""
    # For each component, by its number, and each coefficient: how many bits are left to come.
    left, components, is_progressive, position = np.full((256, 64), 16), [], False, 2
    while (found := MARKER.search(data, position)) is not None and (kind := data[found.start() + 1]) != END:
        start = found.start() + 4
        position = start - 2 + max(2, int.from_bytes(data[start - 2 : start], "big"))
        segment = data[start:position]
        if kind == SCAN and segment and len(segment) >= 4 + 2 * segment[0]:
            first, last, bits = segment[1 + 2 * segment[0] :][:3]
            these = list(segment[1 : 1 + 2 * segment[0] : 2])
            if is_progressive:
                left[these, first : last + 1] = bits & 15
            else:
                left[these] = 0
        elif 0xC0 <= kind <= 0xCF and kind not in NO_FRAMES and len(segment) > 6:
            components, is_progressive = list(segment[6::3]), kind & 3 == 2
    return bool(left[components].any())
