"""Channel-SLAM: delays alone, a particle filter for each transmitter within each particle of the user."""
