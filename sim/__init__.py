"""The world and the receiver: what is true, and what would be measured."""
