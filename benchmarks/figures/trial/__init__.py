"""The figures of one trial, as in the paper's section V."""
