"""Where things stand in the arrays of the compiled filters."""

from __future__ import annotations

# Integers of a VT slot: link, detections, snapshot of the last one, identity.
LINK, HITS, LAST, IDENT, SLOT = 0, 1, 2, 3, 4
# Behind the three coordinates of an anchor: the probability that the VT exists and is visible (belief propagation);
# and what share a guess has in its VT (1: the only one, 0: given up).
EXISTS, SHARE, ANCHOR = 3, 4, 5
# Floats of the configuration.
CLUTTER, GATE, BIRTH, CONFIRM, AGE_ONCE, AGE_TWICE, RIVAL, JOINT = 0, 1, 2, 3, 4, 5, 6, 7
STAY, BACK, DETECTION, DROP, CFG = 8, 9, 10, 11, 12
# What the measurements may do to the map.
FREE, KNOWN_ASSOCIATION, KNOWN_MAP, BELIEF = 0, 1, 2, 3
# Scratch of the geometry: R, dR/dpsi, dR/dtheta, dR/dphi (9 each), prediction (3), H of pose (18), of the VT (9).
ROT, PREDICTED, BY_POSE, BY_VT, GEOMETRY = 0, 36, 39, 57, 66
# Pairs of one link that joint compatibility looks at: VTs, and measurements.
JOINT_VTS, JOINT_MEASUREMENTS = 16, 12
