"""What one snapshot does to a block of particles, step by step; `block_kernel` calls the steps in turn."""
