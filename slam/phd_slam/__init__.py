"""PHD-SLAM: particles over the vehicle's path, in each the map as the intensity of a random finite set."""
