"""Where things stand in the arrays of the compiled filters."""

from __future__ import annotations

# Integers of a VT slot: link, detections, snapshot of the last one, identity.
LINK, HITS, LAST, IDENT, SLOT = 0, 1, 2, 3, 4
# Floats of the configuration.
CLUTTER, GATE, BIRTH, CONFIRM, AGE_ONCE, AGE_TWICE, CFG = 0, 1, 2, 3, 4, 5, 6
# What the measurements may do to the map.
FREE, KNOWN_ASSOCIATION, KNOWN_MAP = 0, 1, 2
# Scratch of the geometry: R, dR/dpsi, dR/dtheta, dR/dphi (9 each), prediction (3), H of pose (18), of the VT (9).
ROT, PREDICTED, BY_POSE, BY_VT, GEOMETRY = 0, 36, 39, 57, 66
