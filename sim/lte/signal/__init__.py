"""The signal-level front end: traced paths in, received symbols, measurements out.

`signal_front_end.SignalLevel.measure` does one snapshot: `channel` and `symbol` say what the array receives of all
cells, `path_estimator` finds the paths in it, knowing what `receiver` holds. A whole drive is measured by
`drive_in_blocks`, in `block_processes`.
"""
