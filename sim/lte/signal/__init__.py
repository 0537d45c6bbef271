"""The signal-level front end: received reference symbols, and the paths that the receiver finds in them."""
