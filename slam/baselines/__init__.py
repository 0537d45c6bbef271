"""What the extended FastSLAM is compared with."""
