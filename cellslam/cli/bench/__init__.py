"""`cellslam bench`: how good estimators are on fixed suites, and one snapshot at signal level."""
