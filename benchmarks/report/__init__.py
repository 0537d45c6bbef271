"""The viewer of sweeps, drives and cities: one self-contained HTML page that works offline."""
