"""How the compiled kernels run: threads, turns, prefetching, compiling ahead of time."""
