"""`cellslam city`: inspect, generate, trace."""
