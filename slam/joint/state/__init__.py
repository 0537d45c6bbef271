"""What a joint filter holds: its layout, states that enter and leave, errors of the array that persist."""
