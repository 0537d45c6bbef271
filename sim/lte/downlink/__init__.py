"""What LTE sends: `reference_signals`, the symbols in time (`ofdm`), and both as a front end asks (`lte_waveform`)."""
