"""The posterior Cramér-Rao bound of a drive: `cramer_rao` has its equations."""
