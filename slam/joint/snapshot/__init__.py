"""What one snapshot does to a joint filter, step by step; `snapshot_kernel` calls the steps in turn."""
