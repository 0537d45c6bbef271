"""Walls in a joint filter.

`images` says which VT is the site and which are its images in walls, `joining` which of them are in one wall and how a
filter learns that, `doubles` which are in two, one after the other, `facades` keeps them over a drive and reports them.
"""
