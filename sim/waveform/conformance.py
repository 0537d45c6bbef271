"""Whether a waveform keeps the protocol: for those that are not built in.

Source: own, docs/how-to/own-waveform.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.waveform.waveform import Waveform

LONGEST_SLOT_S = 0.5e-3  # that the array listens to one of its ports
WANTED = ("slot_s", "slots", "sample_s", "element_hz", "bandwidth_hz", "tones_hz", "comb_step_hz", "combs", "values")
PORTS = ((1, 0), (2, 0))


def checked(given: Any, window_m: float) -> Waveform:
    """Return `given` if it is a waveform whose delays are unambiguous over a window in m. Raises InputError with what
    is wrong.
    """
    kind = type(given).__name__
    lacking = [name for name in WANTED if not hasattr(given, name)]
    if lacking:
        raise InputError(f"{kind} is no waveform: it lacks {', '.join(lacking)}")
    waveform: Waveform = given
    tones = np.asarray(waveform.tones_hz)
    steps = np.diff(tones)
    comb = waveform.combs(PORTS)[0]
    values = np.asarray(waveform.values(PORTS[0], comb, 0))
    reach_m = SPEED_OF_LIGHT_MPS / max(float(steps.max(initial=0.0)), 1e-9)
    for wrong, text in (
        (tones.ndim != 1 or len(tones) < 2 or (steps < 0.0).any(), "tones_hz are not two or more ascending numbers"),
        (np.ptp(tones) > waveform.bandwidth_hz, "tones_hz reach over more than bandwidth_hz"),
        (reach_m < window_m, f"tones are {steps.max(initial=0.0):.6g} Hz apart, so that delays repeat every "
                             f"{reach_m:.0f} m, within the search window of {window_m:g} m"),
        (waveform.slot_s > LONGEST_SLOT_S, f"slot_s = {waveform.slot_s:g} is longer than {LONGEST_SLOT_S:g}, in which "
                                           "the array listens to a port"),
        (values.shape != tones.shape, f"values have shape {values.shape}, tones_hz {tones.shape}"),
        (not np.allclose(np.abs(values), 1.0), "values are not all of magnitude 1"),
        (waveform.slots < 1, f"slots = {waveform.slots}: at least 1"),
    ):  # fmt: skip
        if wrong:
            raise InputError(f"waveform {kind}: {text}")
    return waveform
