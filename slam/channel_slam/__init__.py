"""Channel-SLAM: positioning by the delays of the paths alone."""
