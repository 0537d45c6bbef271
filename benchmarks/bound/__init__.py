"""The posterior Cramer-Rao bound of a drive."""
