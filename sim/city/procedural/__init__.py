"""Generated cities: streets, blocks and houses drawn from a seed. In: the config and a generator; out: a City."""
