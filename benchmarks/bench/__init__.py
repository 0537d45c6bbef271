"""What the `bench` commands measure: speed of rays, front end and sweeps; peers."""
