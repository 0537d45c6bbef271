"""The posterior Cramér-Rao bound of a drive: `cramer_rao` has its equations."""

DETECTIONS_OF_A_TRUE_VT = 20  # VTs that were detected less often count neither in scores of maps nor in their bound
