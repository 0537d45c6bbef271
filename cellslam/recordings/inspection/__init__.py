"""What is in a recording, what is missing, what looks wrong."""
