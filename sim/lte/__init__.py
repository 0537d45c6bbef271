"""The LTE front end: traced paths in, measurements out: distance, azimuth, elevation and SNR per cell and port.

There are two: `statistical` draws what a receiver would report, `signal` receives symbols and estimates paths;
`radio.front_end` chooses. `tools/calibration` measures the constants of the first with the second. Here is what both
share: `radio_config`, the keys; `sites` and their `links`; `downlink`, what is sent; the `array`; `error_bounds`;
`persisting_errors`, which errors are not white; `faults`, clocks that walk and step, reports that come late or twice.
"""

from cellslam.sim.lte.downlink import reference_signal
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.waveform import ReferenceSignal

__all__ = ["RadioConfig", "ReferenceSignal", "reference_signal"]
