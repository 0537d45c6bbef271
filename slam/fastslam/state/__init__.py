"""What a block of particles is: the layout of its rows, the prior, copying, moments."""
