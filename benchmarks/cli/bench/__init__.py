"""`cellslam bench`: how fast and how good the parts are."""
