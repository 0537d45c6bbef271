"""Where each number of a VT lies in its record of 32 doubles (four cache lines).

The first line is all that a VT costs which is not seen: it decides, from the predicted distance, whether the rest is
read.
A VT is kept in spherical coordinates s = (range, azimuth, elevation) about a fixed anchor, the particle's position at
the VT's birth, with axes of the world frame:

    s | theta ~ N(mu + G (theta - theta0), Sigma),   theta = (clock offset of its site, yaw-rate bias, odometer scale)

and theta0 the nuisance mean at the last touch. A VT that is not seen is never written.
"""

POSITION = 0  # 3: Cartesian position at theta0
LAST_SEEN = 3  # snapshot of the last detection
HITS = 4  # detections so far
SPREAD = 5  # standard deviation of the range, without the nuisance part
OFFSET0 = 6  # theta0: clock offset
RANGE_PER_OFFSET = 7  # G[0, 0] again
ANCHOR = 8  # 3
MEAN = 11  # 3: mu
SIGMA = 14  # 6: 00 01 02 11 12 22
GAIN = 20  # 9: G, row by row
BIAS0 = 29  # theta0: yaw-rate bias
SCALE0 = 30  # theta0: odometer scale
IDENTITY = 31  # number of the measurement that the VT was born from
RECORD = 32

# Columns of the scratch row that keeps one VT's prediction while its link is associated.
P_H = 0  # 9: dh/ds
P_A = 9  # 9: dh/dtheta, all paths
P_S = 18  # 6: H Sigma H^T
P_C = 24  # 6: A P A^T
P_Z = 30  # 3: predicted measurement, offset included
P_MEAN = 33  # 3: mu at the present theta
P_J = 36  # 9: d(position)/ds
P_SLOT = 45  # slot in the link's list
P_SCORE0 = 46  # log of visible and detected against missed
P_POSITION = 47  # 3: predicted position
PREDICTION = 52
