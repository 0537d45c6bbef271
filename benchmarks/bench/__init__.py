"""What the `bench` commands measure: speed of rays, front end, FastSLAM and sweeps; peers."""
